"""`phong-bsdf stability`."""

import sys
from pathlib import Path

import click

from .options import threads_option
from .session import errors, progress, start


@click.command()
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for stability.csv, .json, .txt and plots (.svg, with matplotlib).")  # fmt: skip
@click.option("--quick", is_flag=True, help="Fewer inputs; under 30 seconds.")
@click.option("-s", "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the inputs.")
@click.option("-m", "--mode", "variant", help="Mitsuba variant, a JIT one. Default: llvm_ad_rgb.")
@threads_option
def stability(folder, quick, seed, variant, threads):
    """Find the lobes' worst float32 error at each exponent, beside the naive formulas. Exit 1: a bar is missed."""
    with errors():
        start(variant or "llvm_ad_rgb", threads, verbose=False)
        import drjit as dr
        import mitsuba as mi

        from .. import stability as sweeps
        from ..report import stability as report

        if not dr.is_jit_v(mi.Float):
            raise ValueError(f"stability: needs a JIT variant such as llvm_ad_rgb, got '{variant}'")
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        with progress() as show:
            cases = sweeps.QUICK_CASES if quick else sweeps.CASES
            rows = list(sweeps.sweep(cases=cases, seed=seed, on_progress=lambda share: show("sweeping", share)))
        written = report.write(folder, rows) if folder else []
    click.echo(f"{report.table(rows)}\n{report.inputs(rows)}", nl=False)
    if written:
        click.echo(f"\nWritten: {', '.join(map(str, written))}")
    missed = sum(not row.passed for row in rows)
    click.echo(f"\n{len(rows) - missed} of {len(rows)} bars met; C = error / (2^-24 (1 + condition number))")
    sys.exit(1 if missed else 0)
