"""The command `phong-bsdf`: parses, calls, prints. Exit codes: 0 good, 1 a check failed, 2 bad usage or input."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import click

from . import __version__, llvm

LARGEST_SIDE = 65536


class Size(click.ParamType):
    """`640x480`."""

    name = "WxH"

    def convert(self, value, param, ctx):
        sides = str(value).lower().split("x")
        if len(sides) != 2 or not all(side.isdigit() and 0 < int(side) <= LARGEST_SIDE for side in sides):
            self.fail(f"'{value}' is no size; write it as 640x480, sides up to {LARGEST_SIDE}", param, ctx)
        return int(sides[0]), int(sides[1])


class Define(click.ParamType):
    """`name=value`."""

    name = "name=value"

    def convert(self, value, param, ctx):
        name, equals, text = str(value).partition("=")
        if not (name and equals):
            self.fail(f"'{value}' should be name=value", param, ctx)
        return name, text


class Bsdf(click.ParamType):
    """`id=plugin,name=value,...`: a surface, its new plugin, and the plugin's parameters."""

    name = "id=plugin,name=value..."

    def convert(self, value, param, ctx):
        surface, equals, rest = str(value).partition("=")
        plugin, *assignments = rest.split(",")
        pairs = [assignment.partition("=") for assignment in assignments]
        if not (surface and equals and plugin.strip()) or not all(name.strip() and eq for name, eq, _ in pairs):
            self.fail(f"'{value}' should be id=plugin or id=plugin,name=value,name=value", param, ctx)
        return surface, plugin.strip(), {name.strip(): self.parameter(text.strip()) for name, _, text in pairs}

    @staticmethod
    def parameter(text: str):
        """A number, a colour of three numbers, true or false, or else a word."""
        if text in ("true", "false"):
            return text == "true"
        try:
            numbers = tuple(map(float, text.split()))
        except ValueError:
            return text
        return numbers[0] if len(numbers) == 1 else numbers if len(numbers) == 3 else text


def _scene_options(command):
    """The options of every command that renders a scene."""
    options = (
        click.option("-m", "--mode", "variant", help="Mitsuba variant. Default: llvm_ad_rgb, else scalar_rgb."),
        click.option("-D", "--define", "defines", multiple=True, type=Define(),
                     help="Value for a <default> of the scene. May be given several times."),
        click.option("--spp", type=click.IntRange(min=1), help="Samples per pixel. Default: as the scene says."),
        click.option("--size", type=Size(), help="Size of the picture. Default: as the scene says."),
        click.option("--camera", default=1, show_default=True, help="Which sensor of the scene, counted from 1."),
        click.option("-s", "--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True,
                     help="Seed of the sampler."),
        click.option("-t", "--threads", type=click.IntRange(min=1),
                     help="Threads, at least 2. Default: one for each core."),
        click.option("-v", "--verbose", is_flag=True, help="Show Mitsuba's log."),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="phong-bsdf")
def main():
    """Phong, Blinn-Phong, mirrors and a Whitted ray tracer for Mitsuba 3."""


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "outputs", multiple=True, required=True, type=click.Path(path_type=Path),
              help="File to write, .exr (linear) or .png (8 bit). May be given several times.")  # fmt: skip
@_scene_options
@click.option("--linear", is_flag=True, help="PNG: 255 times the value, without the sRGB curve.")
def render(scene, outputs, variant, defines, spp, size, camera, seed, threads, linear, verbose):
    """Render a Mitsuba XML SCENE."""
    with _errors():
        from . import images

        for path in outputs:
            images.check_writable(path)
        _start(variant, threads, verbose)
        from . import rendering

        with _progress() as show:
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


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", required=True, type=click.Path(path_type=Path),
              help="Folder for index.html, .csv, .json and the pictures. Made if need be.")  # fmt: skip
@click.option("--against", multiple=True, metavar="PLUGIN",
              help="Swap every phong and blinnphong BSDF for this one at matched roughness: roughplastic (default), "
                   "roughconductor, principled, diffuse. May be given several times.")  # fmt: skip
@click.option("--bsdf", "choices", multiple=True, type=Bsdf(),
              help="Swap one BSDF for this one; all of these together make one picture. May be given several times, "
                   "for example: ball=roughplastic,int_ior=1.8")  # fmt: skip
@_scene_options
def compare(scene, folder, against, choices, variant, defines, spp, size, camera, seed, threads, verbose):
    """Compare a SCENE's Phong and Blinn-Phong surfaces with Mitsuba's physical BSDFs, on one page."""
    with _errors():
        from . import images
        from .report import page

        images.check_folder(folder)
        page.check_installed()
        _start(variant, threads, verbose)
        from . import comparison
        from .report import comparison as report

        with _progress() as show:
            show("matching", 0)
            given = [comparison.Choice(*choice) for choice in choices]
            planned = comparison.plan(scene, dict(defines), against=against, given=given)
            result = comparison.run(planned, camera=camera, spp=spp or 0, size=size, seed=seed, on_progress=show)
            show("writing", 1)
            written = report.write(folder, result)
    click.echo(report.table(result), nl=False)
    notes = [f"Note: {note}" for note in report.notes(result)]
    click.echo("\n".join(["", *notes, *[""] * bool(notes), f"The page: {written}"]))


@main.command()
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


@main.command()
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for stability.csv, .json, .txt and plots (.svg, with matplotlib).")  # fmt: skip
@click.option("--quick", is_flag=True, help="Fewer inputs; under 30 seconds.")
@click.option("-s", "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the inputs.")
@click.option("-m", "--mode", "variant", help="Mitsuba variant, a JIT one. Default: llvm_ad_rgb.")
@click.option("-t", "--threads", type=click.IntRange(min=1), help="Threads, at least 2. Default: one for each core.")
def stability(folder, quick, seed, variant, threads):
    """Find the lobes' worst float32 error at each exponent, beside the naive formulas. Exit 1: a bar is missed."""
    with _errors():
        _start(variant or "llvm_ad_rgb", threads, verbose=False)
        import drjit as dr
        import mitsuba as mi

        from . import stability as sweeps
        from .report import stability as report

        if not dr.is_jit_v(mi.Float):
            raise ValueError(f"stability: needs a JIT variant such as llvm_ad_rgb, got '{variant}'")
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        with _progress() as show:
            cases = sweeps.QUICK_CASES if quick else sweeps.CASES
            rows = list(sweeps.sweep(cases=cases, seed=seed, on_progress=lambda share: show("sweeping", share)))
        written = report.write(folder, rows) if folder else []
    click.echo(f"{report.table(rows)}\n{report.inputs(rows)}", nl=False)
    if written:
        click.echo(f"\nWritten: {', '.join(map(str, written))}")
    missed = sum(not row.passed for row in rows)
    click.echo(f"\n{len(rows) - missed} of {len(rows)} bars met; C = error / (2^-24 (1 + condition number))")
    sys.exit(1 if missed else 0)


def _start(variant: str | None, threads: int | None, verbose: bool) -> None:
    """Set variant, threads and log level."""
    import drjit as dr
    import mitsuba as mi

    if variant is None:
        variant = "llvm_ad_rgb" if drjit_has_llvm() else "scalar_rgb"
        if variant == "scalar_rgb":
            click.echo(f"Warning: no usable LLVM, so scalar_rgb is used, which is very slow. {llvm.REMEDY}", err=True)
    if variant not in mi.variants():
        raise ValueError(f"there is no variant '{variant}'; this Mitsuba has {', '.join(mi.variants())}")
    try:
        mi.set_variant(variant)
    except llvm.LLVMError:
        raise
    except ImportError as error:
        remedy = llvm.REMEDY if variant.startswith("llvm") else "Its backend was not found on this machine."
        raise ValueError(f"the variant '{variant}' does not work here: {str(error).split('! ')[0]}. {remedy}") from None
    mi.set_log_level(mi.LogLevel.Info if verbose else mi.LogLevel.Warn)
    # With a single thread Mitsuba's bitmap textures wait for ever.
    dr.set_thread_count(max(2, threads or os.cpu_count() or 2))


def drjit_has_llvm() -> bool:
    import drjit

    return drjit.detail.llvm_version()[0] >= llvm.OLDEST


@contextmanager
def _errors():
    """Turn an expected error into one sentence and exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)
    except MemoryError:
        click.echo("Error: the picture does not fit into memory", err=True)
        sys.exit(2)


@contextmanager
def _progress():
    """A progress bar on a terminal, nothing elsewhere. Yields show(what, share done)."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("loading", total=1)
        yield lambda what, share: bar.update(task, description=what, completed=share)
