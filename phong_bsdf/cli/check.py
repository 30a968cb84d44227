"""`phong-bsdf check`."""

import sys
from pathlib import Path

import click

from ..checking.defaults import EDGES, RIGHT, TOLERANCE, UNREADABLE
from .clusters import cluster_options
from .options import scene_options
from .session import errors, progress, start

# From so many pictures on, there is a table instead of sentences.
FEW = 3


@click.command()
@click.argument("pictures", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--linear", is_flag=True, help="PNG and JPEG hold 255 times the value, without the sRGB curve.")
@click.option("--tolerance", type=click.FloatRange(0, 255), default=TOLERANCE, show_default=True,
              help="How far a value may be off, in steps of 8 bits, beyond rounding.")  # fmt: skip
@click.option("--edges", type=click.FloatRange(0, 100), default=100 * EDGES, show_default=True,
              help="Percentage of the pixels that may be off at edges.")  # fmt: skip
@click.option("--diagnosis/--no-diagnosis", "diagnose", default=True, help="Look for the mistake. Default: yes.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.option("--gradescope", type=click.Path(path_type=Path), metavar="RESULTS.json",
              help="Also write the results as a Gradescope autograder does.")  # fmt: skip
@click.option("--points", type=click.FloatRange(0, min_open=True), default=100.0, show_default=True,
              help="Points for --gradescope.")  # fmt: skip
@click.option("--html", "folder", type=click.Path(path_type=Path), metavar="DIR", help="Also write pages into DIR.")
@scene_options
@cluster_options
def check(pictures, scene, linear, tolerance, edges, diagnose, as_json, gradescope, points, folder,
          variant, defines, spp, size, camera, seed, threads, cluster, verbose):  # fmt: skip
    """Check PICTURES that should show SCENE, and say what is wrong with them.

    PICTURES are files (PNG, JPEG, EXR, PPM, BMP, NumPy arrays) or folders of them. Exit 1: some are wrong.
    Exit 2: none could be read.
    """
    with errors():
        from ..checking.pictures import SUFFIXES

        if scene.suffix.lower() in SUFFIXES:
            raise ValueError(f"'{scene}' is a picture; the scene comes last")
        files, left_out = find(pictures, SUFFIXES)
        _check_outputs(folder, gradescope)
        start(variant, threads, verbose)
        from ..checking import grading
        from ..report import check as report

        options = grading.Options(linear, tolerance, edges / 100, diagnose)
        with progress() as show:
            show("rendering", 0)
            assignment = grading.Assignment(
                scene, dict(defines), camera=camera, spp=spp or 0, size=size, seed=seed, options=options
            )
            names, labels = report.page_names(files), report.labels(files)
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
            if cluster:
                grades = _elsewhere(cluster, assignment, dict(defines), files, labels, names, folder, show, verbose)
            else:
                grades = _here(assignment, files, labels, names, folder, show)
        if folder:
            report.write_index(folder, assignment, grades, names)
        if gradescope:
            gradescope.parent.mkdir(parents=True, exist_ok=True)
            report.write_gradescope(gradescope, grades, points)
    if left_out:
        click.echo(f"Left out (not {', '.join(SUFFIXES)}): {', '.join(map(str, left_out))}", err=True)
    code = exit_code([grade.status for grade in grades])
    if as_json:
        said = report.json_text(assignment, grades)
    else:
        said = "".join(report.text(grade) + "\n" for grade in grades) if len(grades) < FEW else report.table(grades)
        said += f"The page: {folder / 'index.html'}\n" if folder else ""
    click.echo(said, nl=False, err=code == 2 and not as_json)
    sys.exit(code)


def _check_outputs(folder, gradescope) -> None:
    """ValueError, before anything is rendered, where the results could not be written."""
    from ..pictures import images
    from ..report import page

    if folder:
        images.check_folder(folder)
        page.check_installed()
    if gradescope:
        if gradescope.is_dir():
            raise ValueError(f"'{gradescope}' is a folder; --gradescope needs a file")
        images.check_folder(gradescope.parent)


def _here(assignment, files, labels, names, folder, show) -> list:
    """The grades of all pictures."""
    from ..report import check as report

    grades = []
    for i, file in enumerate(files):
        show(f"checking {labels[i]}", i / len(files))
        checked = assignment.check(file, labels[i])
        grades.append(checked.grade)
        if folder:
            report.write_page(folder, assignment, checked, names[i])
    return grades


def _elsewhere(choice, assignment, defines, files, labels, names, folder, show, verbose) -> list:
    """The grades of all pictures, by a cluster. What is no file is graded here."""
    import mitsuba as mi

    from ..cluster import checks
    from ..pictures import images
    from ..scene import bundle

    scene = bundle.pack(assignment.loaded.path, defines, choice.root)
    there = [i for i, file in enumerate(files) if file.is_file()]
    missing = [i for i in range(len(files)) if i not in there]
    left = ([of[i] for i in missing] for of in (files, labels, names))
    of_missing = _here(assignment, *left, folder=folder, show=show)
    grades = dict(zip(missing, of_missing, strict=True))
    show("connecting", 0)
    with choice.connected(verbose) as cluster:
        done = checks.run(
            cluster, scene, checks.task(assignment), [files[i] for i in there], [labels[i] for i in there],
            [names[i] if folder else None for i in there], variant=str(mi.variant()), seconds=choice.seconds,
            on_wait=choice.waiting(show),
        )  # fmt: skip
        for number, grade, page in done:
            i = there[number]
            grades[i] = grade
            show(f"checked {len(grades)} of {len(files)}", len(grades) / len(files))
            if folder and page:
                images.replace_file(folder / f"{names[i]}.html", page)
    return [grades[i] for i in range(len(files))]


def find(paths, suffixes) -> tuple[list[Path], list[Path]]:
    """The files, and those of the folders; and what else is in the folders."""
    found, left_out = [], []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        seen = sorted(p for p in path.iterdir() if not p.name.startswith("."))
        inside = [p for p in seen if p.suffix.lower() in suffixes]
        left_out += [p for p in seen if p not in inside]
        if not inside:
            raise ValueError(f"'{path}': there is no picture in this folder ({', '.join(suffixes)})")
        found += inside
    return found, left_out


def exit_code(statuses: list[str]) -> int:
    """0: all are right, 1: some are not, 2: none could be read."""
    if all(status == UNREADABLE for status in statuses):
        return 2
    return int(any(status != RIGHT for status in statuses))
