"""The options of commands that can do their work on a cluster."""

import functools
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

# A command without a bar, as in a batch job, says what it has waited for so long, in seconds.
QUIET = 5


@dataclass(frozen=True)
class Choice:
    """What `--cluster` and the options that go with it say."""

    where: Any
    seconds: float | None
    root: Path | None

    def connected(self, verbose: bool):
        """The cluster, inside `with`; ValueError where it is not there or not fit."""
        from ..cluster import connection

        return connection.connected(self.where, verbose)

    def waiting(self, show) -> Callable[[str], None]:
        """To be called with what is waited for: the bar says it, or, where there is none, a line, once."""
        since, said = {}, set()

        def wait(what: str) -> None:
            show(what, None)
            if not sys.stderr.isatty() and time.monotonic() - since.setdefault(what, time.monotonic()) >= QUIET:
                if what not in said:
                    print(what.capitalize(), file=sys.stderr, flush=True)
                said.add(what)

        return wait


def cluster_options(command):
    """`--cluster` and what goes with it; the command gets a `Choice` or None as `cluster`."""
    from .session import errors

    file = click.Path(path_type=Path)
    options = (
        click.option("--cluster", metavar="WHERE",
                     help="Work on a Dask cluster: local, local:N (processes of this machine), tcp://host:port, "
                          "tls://host:port, or a scheduler file. Name only clusters that you trust."),
        click.option("--task-timeout", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS",
                     help="--cluster: a worker that takes longer for one task hangs, and is replaced. Default: ten "
                          "times as long as others take."),
        click.option("--root", type=click.Path(path_type=Path, file_okay=False),
                     help="--cluster: only files below this folder are sent. Default: the folder of SCENE."),
        click.option("--tls-ca", type=file, help="--cluster: certificate of the authority (PEM)."),
        click.option("--tls-cert", type=file, help="--cluster: certificate of this machine (PEM)."),
        click.option("--tls-key", type=file, help="--cluster: its private key (PEM)."),
    )  # fmt: skip

    @functools.wraps(command)
    def wrapped(*args, cluster, task_timeout, root, tls_ca, tls_cert, tls_key, **more):
        with errors():
            choice = _choice(cluster, task_timeout, root, (tls_ca, tls_cert, tls_key))
        return command(*args, cluster=choice, **more)

    for option in reversed(options):
        wrapped = option(wrapped)
    return wrapped


def _choice(text, seconds, root, tls) -> Choice | None:
    if text is None:
        if seconds or root or any(tls):
            raise ValueError("--task-timeout, --root and the --tls options are for --cluster")
        return None
    from ..cluster import connection

    connection.check_installed()
    return Choice(connection.address(text, tls), seconds, root)
