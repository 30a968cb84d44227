"""`phong-bsdf compare`."""

from pathlib import Path

import click

from .options import Bsdf, scene_options
from .session import errors, progress, start


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", required=True, type=click.Path(path_type=Path),
              help="Folder for index.html, .csv, .json and the pictures. Made if need be.")  # fmt: skip
@click.option("--against", multiple=True, metavar="PLUGIN",
              help="Swap every phong and blinnphong BSDF for this one at matched roughness: roughplastic (default), "
                   "roughconductor, principled, diffuse. May be given several times.")  # fmt: skip
@click.option("--bsdf", "choices", multiple=True, type=Bsdf(),
              help="Swap one BSDF for this one; all of these together make one picture. May be given several times, "
                   "for example: ball=roughplastic,int_ior=1.8")  # fmt: skip
@scene_options
def compare(scene, folder, against, choices, variant, defines, spp, size, camera, seed, threads, verbose):
    """Compare a SCENE's Phong and Blinn-Phong surfaces with Mitsuba's physical BSDFs, on one page."""
    with errors():
        from ..pictures import images
        from ..report import page

        images.check_folder(folder)
        page.check_installed()
        start(variant, threads, verbose)
        from .. import comparison
        from ..report import comparison as report

        with progress() as show:
            show("matching", 0)
            given = [comparison.Choice(*choice) for choice in choices]
            planned = comparison.plan(scene, dict(defines), against=against, given=given)
            result = comparison.run(planned, camera=camera, spp=spp or 0, size=size, seed=seed, on_progress=show)
            show("writing", 1)
            written = report.write(folder, result)
    click.echo(report.table(result), nl=False)
    notes = [f"Note: {note}" for note in report.notes(result)]
    click.echo("\n".join(["", *notes, *[""] * bool(notes), f"The page: {written}"]))
