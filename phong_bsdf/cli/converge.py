"""`phong-bsdf converge`."""

import sys
from pathlib import Path

import click

from ..convergence.defaults import LEVELS, REPEATS
from .clusters import cluster_options
from .options import Levels, MethodSpec, renderer_options
from .session import errors, progress, start


@click.command()
@click.argument("scene", required=False, type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path),
              help="Folder for index.html, .csv, .json, the pictures and all passes. Made if need be; what it holds "
                   "already is not rendered again.")  # fmt: skip
@click.option("--method", "given", multiple=True, type=MethodSpec(),
              help="A method by its name, or a new one: NAME=integrator=path,sampler=stratified,sampling=lobe,"
                   "bsdf=roughplastic,reference=own, and the integrator's parameters. May be given several times. "
                   "Default: all that the scene supports.")  # fmt: skip
@click.option("--spp", "levels", type=Levels(), default=",".join(map(str, LEVELS)), show_default=True,
              help="Samples per pixel to measure at.")  # fmt: skip
@click.option("--repeats", type=click.IntRange(min=1), default=REPEATS, show_default=True,
              help="Independent passes for each method and number of samples.")  # fmt: skip
@click.option(
    "--time-budget",
    type=click.FloatRange(min=0, min_open=True),
    help="Seconds to render: half for the references, half for the passes. The same command again goes on.",
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="EXR file to measure all methods against. Default: what each method converges to.",
)
@click.option("--from", "drawn", type=click.Path(path_type=Path),
              help="Draw again what is in this folder, without rendering.")  # fmt: skip
@click.option("--lobes", is_flag=True, help="Instead of a scene: the formulas of the lobes, beside naive ones.")
@renderer_options
@cluster_options
def converge(scene, folder, given, levels, repeats, time_budget, reference, drawn, lobes, variant, defines, size,
             camera, seed, threads, cluster, verbose):  # fmt: skip
    """Measure the error of rendering methods against their time, on a SCENE of yours. Exit 1: a method failed."""
    with errors():
        from ..pictures import store as passes
        from ..report import page

        _check_arguments(scene, folder, drawn, lobes)
        if cluster and (drawn or lobes):
            raise ValueError("converge: --cluster is for the references of a scene")
        page.check_installed("scipy")
        if drawn:
            with progress() as show:
                failed = _draw(passes.Store(drawn), show)
            sys.exit(1 if failed else 0)
        from ..pictures import images

        images.check_folder(folder)
        start(variant, threads, verbose)
        with progress() as show:
            if lobes:
                failed = _measure_lobes(passes.Store(folder), repeats, seed, show)
            else:
                show("reading", 0)
                from ..convergence import planning

                planned = planning.plan(
                    scene, dict(defines), given=given, levels=levels, repeats=repeats, camera=camera, size=size,
                    seed=seed, reference=reference,
                )  # fmt: skip
                elsewhere = _Elsewhere(cluster, scene, dict(defines), show, verbose) if cluster else None
                failed = _measure(passes.Store(folder), planned, time_budget, show, elsewhere)
    sys.exit(1 if failed else 0)


def _check_arguments(scene, folder, drawn, lobes) -> None:
    if drawn and (scene or folder or lobes):
        raise ValueError("converge: --from draws what a folder holds; give no scene, no -o and no --lobes with it")
    if not drawn and (scene is None) != lobes:
        raise ValueError("converge: give a scene, --lobes, or --from with a folder that was measured before")
    if not drawn and folder is None:
        raise ValueError("converge: give a folder to write to: -o DIR")


def _measure(store, planned, time_budget, show, elsewhere) -> bool:
    from ..convergence import measuring, planning

    with store.opened():
        planning.write_run(store, planned.run)
        if elsewhere:
            elsewhere.make_references(planned, store, (time_budget or float("inf")) / 2)
        measuring.measure(planned, store, time_budget=time_budget or float("inf"), on_progress=show)
        return _draw(store, show)


def _measure_lobes(store, repeats, seed, show) -> bool:
    from ..convergence import lobe_errors

    with store.opened():
        lobe_errors.measure(store, repeats=repeats, seed=seed, on_progress=show)
        return _draw(store, show)


class _Elsewhere:
    """Makes references on a cluster, and lets go of it before anything is timed."""

    def __init__(self, choice, scene, defines, show, verbose):
        from ..scene import bundle

        self.choice, self.show, self.verbose = choice, show, verbose
        self.scene = bundle.pack(scene, defines, choice.root)

    def make_references(self, planned, store, time_budget) -> None:
        from ..cluster import references

        self.show("connecting", 0)
        with self.choice.connected(self.verbose) as cluster:
            references.render(
                cluster, self.scene, planned, store, time_budget=time_budget, seconds=self.choice.seconds,
                on_progress=self.show, on_wait=self.choice.waiting(self.show),
            )  # fmt: skip


def _draw(store, show) -> bool:
    """Write the page and print the table; whether a method failed."""
    from ..convergence import conclusions, lobe_errors, planning
    from ..report import convergence as report
    from ..report import lobe_errors as lobe_report

    if lobe_errors.is_measured(store):
        found = lobe_errors.read(store)
        written, said, failed = lobe_report.write(store.folder, found), lobe_report.text_table(found), False
    else:
        found, pictures = conclusions.conclude(store, planning.read_run(store), show)
        show("writing", 1)
        written, said = report.write(store.folder, found, pictures), report.text_table(found)
        said += "".join(f"\nNote: {warning}" for warning in report.warnings(found))
        failed = any(result.failure for result in found.results)
    click.echo(f"{said.rstrip()}\n\nThe page: {written}")
    return failed
