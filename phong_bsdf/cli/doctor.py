"""`phong-bsdf doctor`."""

import subprocess
import sys

import click

from ..host import llvm


@click.command()
def doctor():
    """Show which LLVM Dr.Jit uses, and prove in a child process that it works."""
    for name, value in llvm.describe().items():
        click.echo(f"{name:24}{value}")
    # In a child process: a bad LLVM ends the process that asks it to compile.
    proof = (
        "import phong_bsdf, mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr; "
        "assert dr.sum(dr.square(mi.Float([1, 2, 3])))[0] == 14"
    )
    child = subprocess.run([sys.executable, "-c", proof], capture_output=True, text=True)
    if child.returncode == 0:
        click.echo(f"{'llvm_ad_rgb':24}works")
        return
    reason = child.stderr.strip().rsplit("\n", 1)[-1] or f"the process ended with code {child.returncode}"
    click.echo(f"{'llvm_ad_rgb':24}does not work: {reason}")
    if llvm.REMEDY not in reason:
        click.echo(llvm.REMEDY)
    sys.exit(1)
