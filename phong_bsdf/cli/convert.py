"""`phong-bsdf convert`."""

import sys
from pathlib import Path

import click

from ..reflection.vocabulary import VOCABULARIES
from .session import errors, progress, start, to_copy


@click.command()
@click.argument("source", metavar="OLD", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path),
              help="Scene to write, .xml. Its meshes and images go into a folder beside it.")  # fmt: skip
@click.option("--vocabulary", type=click.Choice(list(VOCABULARIES)),
              help="OBJ: write highlights as the lecture's kd, ks, p (default), or as reflectances.")  # fmt: skip
@click.option(
    "--camera", type=click.Choice(["auto", "none"]), help="OBJ: a camera that sees it all (default), or none."
)
@click.option("--root", type=click.Path(path_type=Path, file_okay=False),
              help="Files are read below this folder only. Default: the folder of OLD.")  # fmt: skip
@click.option(
    "--check/--no-check", default=True, help="Load the new scene to see whether Mitsuba takes it. Default: yes."
)
def convert(source, output, vocabulary, camera, root, check):
    """Convert OLD, a Mitsuba 0.x scene (.xml) or a model (.obj with .mtl), into a scene of today.

    Prints every change, and everything that could not be carried over. Exit 1: Mitsuba does not load the new scene.
    """
    with errors():
        kind = source.suffix.lower()
        if kind not in (".xml", ".obj"):
            raise ValueError(f"'{source}': the input must be a Mitsuba 0.x scene (.xml) or a model (.obj)")
        if kind == ".xml" and (vocabulary or camera):
            raise ValueError("--vocabulary and --camera are for models (.obj); a scene has its own")
        start(None, None, verbose=False)
        from .. import importers

        with progress() as show:
            if kind == ".xml":
                result = importers.convert_scene(source, output, root=root, on_progress=show)
            else:
                options = {"vocabulary": vocabulary or "coefficients", "camera": camera or "auto"}
                result = importers.convert_model(source, output, root=root, on_progress=show, **options)
        click.echo(importers.story(result), nl=False)
        has_camera, refusal = _load(output) if check else (True, None)
    if refusal:
        click.echo(f"\nMitsuba does not load it yet. {refusal}", err=True)
        sys.exit(1)
    if not has_camera:
        click.echo("\nIt has no camera yet: add a <sensor> to render it.")
        return
    click.echo(f"\nRender it with: {to_copy('render', output, '-o', output.with_suffix('.png'))}")


def _load(scene: Path) -> tuple[bool, str | None]:
    """Whether a scene has a camera, and why Mitsuba does not load it, None if it does."""
    from ..scene import rendering

    try:
        return bool(rendering.load(scene).scene.sensors()), None
    except rendering.SceneError as error:
        return False, str(error)
