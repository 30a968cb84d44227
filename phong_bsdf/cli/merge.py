"""`phong-bsdf merge`."""

from pathlib import Path

import click

from .options import linear_option, outputs_option
from .session import errors, progress


@click.command()
@click.argument("given", nargs=-1, required=True, metavar="PART...", type=click.Path(path_type=Path))
@outputs_option
@linear_option
@click.option("--mixed-versions", is_flag=True, help="Merge also what different versions of the software rendered.")
def merge(given, outputs, linear, mixed_versions):
    """Merge pictures of different samples of one scene into their mean.

    A PART is an .exr file that `phong-bsdf render` wrote, each with its own --seed, or a folder of `render --passes`.
    """
    with errors():
        from ..pictures import images, parts

        for path in outputs:
            images.check_writable(path)
        files = _files(given)
        for path in outputs:
            if path.resolve() in files:
                raise ValueError(f"'{path}' is one of the parts; choose another name for the result")
        with progress() as show:
            show("reading", 0)
            found = parts.ordered(parts.read(path) for path in files.values())
            parts.check(found, mixed_versions=mixed_versions)
            for path in outputs:
                images.check_channels(path, found[0].channels)
            mean = parts.merged(found, lambda share: show("merging", share))
            image, metadata = mean.image(), parts.merged_metadata(found)
            for path in outputs:
                images.write(path, image, channels=found[0].channels, linear=linear, metadata=metadata)
    from .passes import percent

    width, height = found[0].subject.size
    click.echo(f"{', '.join(map(str, outputs))}: {width} x {height}, {mean.samples} spp of {mean.count} part"
               f"{'' if mean.count == 1 else 's'}, error {percent(mean.relative_error())}")  # fmt: skip


def _files(given) -> dict[Path, Path]:
    """The files of all parts, by what they really are; ValueError where one is given twice."""
    files = {}
    for path in given:
        for file in _passes(path) if path.is_dir() else [path]:
            if (real := file.resolve()) in files:
                raise ValueError(f"'{file}' is given twice" if file == files[real] else
                                 f"'{file}' and '{files[real]}' are the same file")  # fmt: skip
            files[real] = file
    if not files:
        raise ValueError("there is nothing to merge yet: no pass is finished")
    return files


def _passes(folder: Path) -> list[Path]:
    from ..pictures.store import PICTURE, Store

    found = Store(folder).files()
    if not found and not (folder / PICTURE).is_file():
        raise ValueError(f"'{folder}' holds no passes; merge takes the folders of `phong-bsdf render --passes`")
    return found
