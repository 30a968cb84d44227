"""Grades as text, a table, JSON, Gradescope's results and HTML pages."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..checking.defaults import RIGHT, UNREADABLE
from ..checking.grading import Assignment, Checked, Finding, Grade
from ..pictures.images import replace_file
from . import page, tables

# The brightest colour of a heat map: so many times what is allowed.
HEAT = 8.0

# Candidates that explain less are not worth a line.
WORTH_TELLING = 0.1

# Confidence, in words.
ALMOST_SURE, PROBABLE = 0.95, 0.8

# So many candidates have a picture.
MOST_SHOWN = 3

NONE_OF_THESE = "None of the usual mistakes explains the picture."


def text(grade: Grade) -> str:
    """What a student should read."""
    if grade.status == UNREADABLE:
        return f"{grade.picture}: {grade.status}: {grade.words}"
    lines = [f"{grade.picture}: {grade.status}, score {score(grade)}", f"  {grade.words}"]
    if grade.mistake:
        confidence = percent(grade.mistake.confidence)
        lines.append(f"  {certainty(grade.mistake)}: {grade.mistake.title} (confidence {confidence}).")
        lines.append(f"    {grade.mistake.advice}")
        lines += [f"    In this scene it looks the same where {other}." for other in grade.mistake.same]
    elif grade.diagnosed:
        lines.append(f"  {NONE_OF_THESE}")
    if grade.mistake and grade.mistake.confidence < ALMOST_SURE:
        others = [m for m in grade.candidates if m != grade.mistake and m.explained >= WORTH_TELLING]
        lines += [f"  Less likely: {m.title} (explains {percent(m.explained)})." for m in others[:2]]
    return "\n".join([*lines, *(f"  Note: {note}." for note in grade.notes)])


def certainty(mistake: Finding) -> str:
    """The confidence in words."""
    if mistake.confidence >= ALMOST_SURE:
        return "Almost surely"
    return "Probably" if mistake.confidence >= PROBABLE else "Perhaps"


def percent(share: float) -> str:
    """A part of 1 in per cent; what is not all of it is not 100 %."""
    return f"{min(round(100 * share), 99) if share < 0.9995 else 100} %"


def score(grade: Grade, points: float = 1.0) -> str:
    """The score, of `points`, with two digits; what is not right does not have all of them."""
    return f"{points if grade.status == RIGHT else _floor(points * grade.score):.2f}"


def off(grade: Grade) -> str:
    """The part of the pixels that is off; a few of many are not 0."""
    if grade.pixels_off is None:
        return "-"
    return "< 0.01 %" if 0 < grade.pixels_off < 1e-4 else f"{100 * grade.pixels_off:.2f} %"


def table(grades: Sequence[Grade]) -> str:
    """One line a picture."""
    rows = []
    for grade in grades:
        rows.append((grade.picture, grade.status, score(grade), off(grade)))
    lines = tables.text_table(("picture", "verdict", "score", "off"), rows).splitlines()
    mistakes = ["mistake", "-------", *map(_short, grades)]
    lines = [f"{line}  {mistake}".rstrip() for line, mistake in zip(lines, mistakes, strict=True)]
    right = sum(grade.status == RIGHT for grade in grades)
    return "\n".join([*lines, f"{right} of {len(grades)} right\n"])


def json_text(assignment: Assignment, grades: Sequence[Grade]) -> str:
    """All grades, with scene, options and versions."""
    return tables.json_text({"context": tables.context(), "scene": assignment.name, "options": assignment.options,
                             "grades": list(grades)})  # fmt: skip


def write_gradescope(path: Path, grades: Sequence[Grade], points: float) -> None:
    """Results as Gradescope's autograder reads them: one test a picture, `points` shared evenly."""
    each = points / len(grades)
    tests = [
        {
            "name": Path(grade.picture).name, "number": str(number), "score": float(score(grade, each)),
            "max_score": round(each, 2), "status": "passed" if grade.status == RIGHT else "failed",
            "output": text(grade), "output_format": "text", "visibility": "visible",
        }
        for number, grade in enumerate(grades, 1)
    ]  # fmt: skip
    right = sum(grade.status == RIGHT for grade in grades)
    summary = f"{right} of {len(grades)} picture{'' if len(grades) == 1 else 's'} right."
    # The sum of rounded parts is not the total.
    total = points if right == len(grades) else _floor(each * sum(grade.score for grade in grades))
    replace_file(path, tables.json_text({"score": total, "output": summary, "output_format": "text", "tests": tests}))


def write_page(folder: Path, assignment: Assignment, checked: Checked, name: str) -> None:
    """The page of one picture, `name`.html."""
    grade = checked.grade
    page.write(
        Path(folder) / f"{name}.html", "check.html", title=f"{Path(grade.picture).name}: {grade.status}",
        summary=f"{assignment.name}, {assignment.size[0]} × {assignment.size[1]}, score {score(grade)}",
        context=tables.context(), grade=grade, percent=percent, certainty=certainty, none_of_these=NONE_OF_THESE,
        heat_scale=tables.number(HEAT), pictures=_pictures(assignment, checked),
    )  # fmt: skip


def _pictures(assignment: Assignment, checked: Checked) -> dict[str, object] | None:
    """What the page shows of a picture that could be read."""
    if checked.picture is None or checked.expected is None or checked.excess is None:
        return None
    images = {"expected": checked.expected, "handed in": checked.picture.values}
    shown = []
    for explanation, mistake in zip(checked.explanations[:MOST_SHOWN], checked.grade.candidates, strict=False):
        if mistake == checked.grade.mistake or mistake.explained >= WORTH_TELLING:
            image = assignment.picture_of(checked, explanation)
            shown.append((mistake, page.picture(image, linear=True)))
            if mistake == checked.grade.mistake:
                images["with the mistake"] = image
    decoded = {key: checked.picture.encoding.decode(image).astype(np.float32) for key, image in images.items()}
    difference = np.abs(decoded["handed in"] - decoded["expected"])
    return {
        "expected": page.picture(checked.expected, linear=True),
        "handed_in": page.picture(checked.picture.values, linear=True),
        "heat": page.picture(page.false_colours(np.minimum(checked.excess, 1e6)[..., None], HEAT), linear=True),
        "shown": shown,
        "viewer": page.viewer(decoded, page.difference_scale([difference])),
    }


def write_index(folder: Path, assignment: Assignment, grades: Sequence[Grade], names: Sequence[str]) -> Path:
    """The page of all pictures, index.html; returns its path."""
    path = Path(folder) / "index.html"
    right = sum(grade.status == RIGHT for grade in grades)
    page.write(
        path, "check_index.html", title=f"{assignment.name}: {right} of {len(grades)} right",
        summary=f"{assignment.size[0]} × {assignment.size[1]}, tolerance {assignment.options.tolerance:g} of 255, "
        f"edges {100 * assignment.options.edges:g} %",
        context=tables.context(),
        rows=[(g, name, score(g), off(g), _short(g)) for g, name in zip(grades, names, strict=True)],
    )  # fmt: skip
    return path


def labels(files: Sequence[Path]) -> list[str]:
    """What the files are called: their names, with folders where those are needed to tell them apart."""
    files = [Path(file) for file in files]
    if len({file.name for file in files}) == len(files):
        return [file.name for file in files]
    return [str(file) for file in files]


def page_names(files: Sequence[Path]) -> list[str]:
    """A name for each file's page; files of the same name in other folders are numbered."""
    names: list[str] = []
    for file in files:
        # index.html is the page of all.
        stem = name = "picture-index" if Path(file).stem == "index" else Path(file).stem
        number = 1
        while name.lower() in (other.lower() for other in names):
            number += 1
            name = f"{stem}-{number}"
        names.append(name)
    return names


def _floor(number: float) -> float:
    """To two digits, never up."""
    # Sums like 9.999999999999998 are meant to be 10.
    return math.floor(100 * number + 1e-6) / 100


def _short(grade: Grade) -> str:
    if grade.status == RIGHT:
        return ""
    if grade.status == UNREADABLE:
        return grade.words.rstrip(".")
    if grade.mistake:
        return f"{grade.mistake.title} ({percent(grade.mistake.confidence)})"
    return "none of the usual" if grade.diagnosed else "not diagnosed"
