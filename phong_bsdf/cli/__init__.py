"""The command `phong-bsdf`: parses, calls, prints. Exit codes: 0 good, 1 a check failed, 2 bad usage or input. Imports
anything."""

import click

from .. import __version__
from .check import check
from .compare import compare
from .converge import converge
from .convert import convert
from .demo import demo
from .doctor import doctor
from .explain import explain
from .explore import explore
from .merge import merge
from .render import render
from .stability import stability
from .sweep import sweep


class Commands(click.Group):
    """A group whose help lists the commands in their order here, each with a whole sentence."""

    def list_commands(self, ctx):
        return list(self.commands)

    def format_commands(self, ctx, formatter):
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(200)) for name, command in self.commands.items()])


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="phong-bsdf")
def main():
    """Phong, Blinn-Phong, mirrors and a Whitted ray tracer for Mitsuba 3."""


for command in (render, sweep, merge, check, convert, compare, converge, explain, explore, stability, demo, doctor):
    main.add_command(command)
