"""`phong-bsdf demo`."""

from pathlib import Path

import click

from .options import mode_option, threads_option, verbose_option
from .session import errors, progress, start, to_copy


@click.command()
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), default=Path("demo"), show_default=True,
              metavar="DIR", help="Where the pictures and the scenes go.")  # fmt: skip
@click.option("--spp", type=click.IntRange(min=1), help="Samples per pixel. Default: as the scenes say.")
@mode_option
@threads_option
@verbose_option
def demo(folder, spp, variant, threads, verbose):
    """Render the lecture's pictures, and put their scenes beside them, to be changed."""
    with errors():
        from ..pictures import images

        images.check_folder(folder)
        start(variant, threads, verbose)
        from .. import demo as lecture

        folder.mkdir(parents=True, exist_ok=True)
        said, total = [], len(lecture.scenes())
        with progress() as show:
            show("rendering", 0)
            for picture in lecture.draw(spp or 0):
                scene = folder / picture.scene.name
                # One that was changed is kept.
                if not scene.exists():
                    images.replace_file(scene, picture.scene.read_text(encoding="utf-8"))
                path = folder / f"{picture.scene.stem}.png"
                images.write(path, picture.image)
                said.append(f"{path}: {picture.shows}")
                show("rendering", len(said) / total)
    click.echo("\n".join(said))
    click.echo(f"\nThe scenes are beside them. Change one, then: {to_copy('render', scene, '-o', 'new.png')}")
