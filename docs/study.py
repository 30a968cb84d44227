"""Measures the three scenes of docs/error-vs-time.md, and puts their plots, pictures and tables into it: `make study`.

What is on disk in out/study is not measured again.
"""

import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pages

from phong_bsdf.convergence import conclusions, lobe_errors
from phong_bsdf.pictures import images
from phong_bsdf.pictures.store import Store
from phong_bsdf.report import convergence_tables

ROOT = Path(__file__).parent.parent
PAGE = "error-vs-time.md"
OUT = ROOT / "out/study"

# Name -> arguments of `phong-bsdf converge`; the page shows the same.
STUDIES = {
    "mirror-floor": "scenes/lecture/mirror-floor.xml --size 120x80",
    "glossy": "scenes/compare/balls.xml --size 128x96 --spp 1,4,16,64,256",
    "lights": "scenes/converge/thousand-lights.xml --size 96x72 --spp 4,16,64,256,1024 --method path --method direct "
    '--method path-multijitter --method "whitted=spp=1 4 16"',
    "lobes": "--lobes --repeats 3",
}

# In the strip of pictures.
SHOWN = {
    "mirror-floor": ("reference whitted", "whitted", "reference path", "path", "direct", "path-lobe"),
    "glossy": ("reference path", "path", "path-multijitter", "path-lobe", "direct", "path-ldsampler"),
    "lights": ("reference whitted", "path", "direct", "path-multijitter", "whitted"),
}


def main():
    """Measure, then write docs/images/study-*.png and .svg and the tables of the page."""
    for name, arguments in STUDIES.items():
        print(f"{name}:", flush=True)
        command = [sys.executable, "-m", "phong_bsdf", "converge", *shlex.split(arguments), "-o", str(OUT / name)]
        subprocess.run(command, check=True, cwd=ROOT)
        if name == "lobes":
            pages.insert(name, lobe_table(lobe_errors.read(Store(OUT / name))), PAGE)
            continue
        found, pictures = conclusions.read(OUT / name)
        image = strip(pictures, SHOWN[name], conclusions.against(found.run))
        images.write(pages.IMAGES / f"study-{name}.png", image)
        plot = (OUT / name / "relmse.svg").read_text(encoding="utf-8")
        images.replace_file(pages.IMAGES / f"study-{name}.svg", plot)
        pages.insert(name, convergence_tables.equal_time_text(found), PAGE)


def strip(pictures, names, against) -> np.ndarray:
    """Pictures side by side, enlarged; below those of methods their errors."""
    maps = (pages.error_map(pictures[name] - pictures[against.get(name, name)]) for name in names)
    rows = pages.below([pages.beside(pictures[name] for name in names), pages.beside(maps)])
    return rows.repeat(2, 0).repeat(2, 1)


def lobe_table(found: lobe_errors.LobeErrors) -> str:
    """Errors and times of the value, formula beside formula."""
    from phong_bsdf.report import tables

    rows = {(r.lobe, r.p, r.formula): r for r in found.rows if r.quantity == "value"}
    lines = []
    for lobe, p in dict.fromkeys((lobe, p) for lobe, p, _ in rows):
        line = [lobe, f"{p:g}"]
        for formula in lobe_errors.FORMULAS:
            row = rows.get((lobe, p, formula))
            line += [tables.number(row and row.error.value), tables.number(row and row.nanoseconds.median)]
        lines.append(line)
    headings = ("lobe", "p", *(f"{f} {what}" for f in lobe_errors.FORMULAS for what in ("error", "ns")))
    return tables.text_table(headings, lines)


if __name__ == "__main__":
    main()
