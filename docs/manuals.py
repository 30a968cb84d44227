"""Manuals that the source holds already, put into the pages while Sphinx reads them.

A plugin's manual is the docstring of its class; a command's is what `--help` prints.
"""

import ast
import re
from pathlib import Path

import click

from phong_bsdf.cli import main

PLUGINS = Path(__file__).parent.parent / "phong_bsdf/plugins"
CLI = Path(__file__).parent.parent / "phong_bsdf/cli"

# In a page, these ask for the manual of a plugin, and for those of all commands.
PLUGIN = re.compile(r"^<!-- manual of (\w+) -->$", re.M)
COMMANDS = re.compile(r"^<!-- manuals of the commands -->$", re.M)

EXAMPLES = {"XML::": "xml", "Python::": "python"}


def insert(app, docname, source):
    """For Sphinx, when it reads a page: marks become manuals, and the page is read again when those change."""
    text = source[0]
    if COMMANDS.search(text):
        for path in CLI.glob("*.py"):
            app.env.note_dependency(path)
    for plugin in PLUGIN.findall(text):
        app.env.note_dependency(PLUGINS / f"{plugin}.py")
    text = PLUGIN.sub(lambda mark: f"```{{eval-rst}}\n{restructured(manual(mark[1]))}\n```", text)
    source[0] = COMMANDS.sub(lambda _: commands(), text)


def manual(plugin: str) -> str:
    """The docstring of the class in `plugins/PLUGIN.py`. It is not imported: it would be a class of one variant."""
    module = ast.parse((PLUGINS / f"{plugin}.py").read_text(encoding="utf-8"))
    (found,) = (node for node in module.body if isinstance(node, ast.ClassDef))
    return ast.get_docstring(found)


def restructured(text: str) -> str:
    """reStructuredText: names become code, formulas stay as they are typed, examples get their colours."""
    paragraphs = [".. default-role:: code"]
    for paragraph in text.split("\n\n"):
        language = EXAMPLES.get(paragraphs[-1])
        if language:
            paragraphs[-1] = paragraphs[-1].removesuffix(":")
            paragraphs.append(f".. code-block:: {language}\n\n{paragraph}")
        elif paragraph.startswith("    "):
            paragraphs.append(f"::\n\n{paragraph}")
        else:
            paragraphs.append(paragraph)
    return "\n\n".join([*paragraphs, ".. default-role::"])


def commands() -> str:
    """Markdown: a heading for each command, and below it what its `--help` prints."""
    context = click.Context(main, info_name="phong-bsdf", **main.context_settings)
    return "\n\n".join(
        f"## {name}\n\n```text\n{usage(command, click.Context(command, context, name))}```"
        for name, command in main.commands.items()
    )


def usage(command: click.Command, context: click.Context) -> str:
    """What `--help` prints, at a width that fits into a page."""
    formatter = click.HelpFormatter(width=92)
    command.format_help(context, formatter)
    return formatter.getvalue()
