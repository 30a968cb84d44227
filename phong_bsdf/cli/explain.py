"""`phong-bsdf explain`."""

from pathlib import Path

import click

from .options import scene_options
from .session import errors, progress, start


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for explain.csv, .json and .txt.")  # fmt: skip
@scene_options
def explain(scene, folder, variant, defines, spp, size, camera, seed, threads, verbose):
    """Show what the kernel for a SCENE leaves out because the scene does not need it, and what that saves."""
    with errors():
        from ..pictures import images

        if folder:
            images.check_folder(folder)
        start(variant, threads, verbose)
        from .. import explanation
        from ..report import explanation as report
        from ..scene import rendering

        with progress() as show:
            show("loading", 0)
            loaded = rendering.load(scene, dict(defines))
            if size:
                rendering.resize(loaded, camera, *size)
            result = explanation.explain(loaded, camera=camera, spp=spp or 0, seed=seed, on_progress=show)
        if folder:
            report.write(folder, result)
    click.echo(report.text(result), nl=False)
