"""`phong-bsdf render`."""

from pathlib import Path

import click

from .. import __version__
from .options import scene_options
from .session import errors, progress, start


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "outputs", multiple=True, required=True, type=click.Path(path_type=Path),
              help="File to write, .exr (linear) or .png (8 bit). May be given several times.")  # fmt: skip
@scene_options
@click.option("--linear", is_flag=True, help="PNG: 255 times the value, without the sRGB curve.")
def render(scene, outputs, variant, defines, spp, size, camera, seed, threads, linear, verbose):
    """Render a Mitsuba XML SCENE."""
    with errors():
        from .. import images

        for path in outputs:
            images.check_writable(path)
        start(variant, threads, verbose)
        from .. import rendering

        with progress() as show:
            show("loading", 0)
            loaded = rendering.load(scene, dict(defines))
            if size:
                rendering.resize(loaded, camera, *size)
            show("rendering", 0)
            result = rendering.render(
                loaded, camera=camera, spp=spp or 0, seed=seed, on_progress=lambda share: show("rendering", share)
            )
        metadata = {
            "phong_bsdf": __version__, "scene": scene.name, "variant": result.variant,
            "spp": str(result.spp), "seed": str(seed),
        }  # fmt: skip
        for path in outputs:
            images.write(path, result.image, linear=linear, metadata=metadata)
    height, width = result.image.shape[:2]
    click.echo(
        f"{', '.join(map(str, outputs))}: {width} x {height}, {result.spp} spp, "
        f"{result.lights} light{'' if result.lights == 1 else 's'}, {result.variant}; loading {loaded.seconds:.2f} s, "
        f"compiling {result.seconds_compiling:.2f} s, rendering {result.seconds_rendering:.2f} s"
    )
