"""`phong-bsdf render`."""

from pathlib import Path

import click

from .clusters import cluster_options
from .options import linear_option, outputs_option, scene_options
from .session import errors, progress, start


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@outputs_option
@scene_options
@linear_option
@click.option("--passes", "folder", type=click.Path(path_type=Path),
              help="Render in passes, each kept in this folder: a run that ends early has lost nothing.")  # fmt: skip
@click.option("--pass-spp", type=click.IntRange(min=1),
              help="Samples per pixel of a pass, rounded to a power of two. Default: some seconds' work.")  # fmt: skip
@click.option("--target-error", type=click.FloatRange(min=0, min_open=True), metavar="PERCENT",
              help="End after the pass at which the picture's relative standard error is below this.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with the passes that the folder holds; with more --spp, add some.")
@cluster_options
def render(scene, outputs, variant, defines, spp, size, camera, seed, threads, linear, folder, pass_spp, target_error,
           resume, cluster, verbose):  # fmt: skip
    """Render a Mitsuba XML SCENE.

    An .exr file holds all channels under the names that Mitsuba gives them, a .png file the colour.
    """
    with errors():
        from ..pictures import images

        if cluster and folder is None:
            # What comes from elsewhere is kept.
            folder = outputs[0].with_suffix(".passes")
        for option, value in {"--pass-spp": pass_spp, "--target-error": target_error, "--resume": resume}.items():
            if value and folder is None:
                raise ValueError(f"{option} is for a picture in passes; say where to keep them: --passes DIR")
        for path in outputs:
            images.check_writable(path)
        if folder is not None:
            if folder.resolve() in [path.resolve() for path in outputs]:
                raise ValueError(f"'{folder}' cannot be both the picture and the folder of its passes")
            images.check_folder(folder)
        start(variant, threads, verbose)
        from ..progressive import planning

        with progress() as show:
            show("loading", 0)
            loaded, subject = planning.load(scene, dict(defines), camera=camera, size=size)
            picture = Picture(outputs, linear, loaded, subject)
            picture.check()
            if folder is None:
                said = picture.at_once(spp or 0, seed, show)
            else:
                from .passes import Elsewhere, in_passes

                elsewhere = Elsewhere(cluster, scene, dict(defines), size, verbose, show) if cluster else None
                said = in_passes(picture, folder, spp=spp, seed=seed, pass_spp=pass_spp, target=target_error,
                                 resume=resume, show=show, elsewhere=elsewhere)  # fmt: skip
    click.echo(said)


class Picture:
    """The files that a command writes, and the scene that they show."""

    def __init__(self, outputs, linear, loaded, subject):
        from ..scene import rendering

        self.outputs, self.linear, self.loaded, self.subject = outputs, linear, loaded, subject
        self.channels = rendering.channels(loaded, subject.camera)

    def check(self) -> None:
        """ValueError where a file cannot hold the picture's channels."""
        from ..pictures import images

        for path in self.outputs:
            images.check_channels(path, self.channels)

    def at_once(self, spp: int, seed: int, show) -> str:
        """Render and write it; a line to say about it."""
        from ..progressive import planning
        from ..scene import rendering

        show("rendering", 0)
        samples = planning.samples_of(self.loaded, self.subject, spp, seed)
        result = rendering.render(self.loaded, camera=self.subject.camera, spp=spp, seed=seed,
                                  on_progress=lambda share: show("rendering", share))  # fmt: skip
        self.write(result.image, [samples])
        return (
            f"{self.summary(samples.spp, result.lights)}; loading {self.loaded.seconds:.2f} s, "
            f"compiling {result.seconds_compiling:.2f} s, rendering {result.seconds_rendering:.2f} s"
        )

    def write(self, image, samples) -> None:
        """Write the files."""
        from ..pictures import images, parts

        for path in self.outputs:
            said = parts.metadata(self.subject, samples)
            images.write(path, image, channels=self.channels, linear=self.linear, metadata=said)

    def summary(self, spp: int, lights: int) -> str:
        """Files, size, samples, lights, variant."""
        width, height = self.subject.size
        return (f"{', '.join(map(str, self.outputs))}: {width} x {height}, {spp} spp, "
                f"{lights} light{'' if lights == 1 else 's'}, {self.subject.variant}")  # fmt: skip
