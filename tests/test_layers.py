"""The layers of docs/architecture.md: a folder imports only from those above it."""

import ast
import re
import subprocess
import sys

import pytest

from helpers import ROOT

PACKAGE = ROOT / "phong_bsdf"


def documented():
    """Folder or module -> number of its row, from the table in docs/architecture.md."""
    text = (ROOT / "docs/architecture.md").read_text()
    rows = re.findall(r"^\| (`[^|]*`) \|", text, re.M)
    return {name.rstrip("/"): i for i, row in enumerate(rows) for name in re.findall(r"`([\w/]+)`", row)}


def room(parts):
    """The folder, or the module beside the folders, in which a module of the package is."""
    return parts[0] if parts and parts[0] != "__init__" else "__init__"


def imported(path):
    """Rooms from which `path` imports, anywhere in it."""
    package = path.relative_to(PACKAGE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("phong_bsdf")):
            above = list(package[: len(package) - node.level + 1]) if node.level else []
            target = above + [part for part in (node.module or "").split(".") if part not in ("", "phong_bsdf")]
            for alias in node.names:
                # From the package itself: its folders, its modules, or what `__init__` holds.
                yield room(target or ["__init__" if alias.name.startswith("__") else alias.name])


def test_imports_are_read():
    """Relative ones of every depth, and absolute ones."""
    assert set(imported(PACKAGE / "scene/rendering.py")) >= {"pictures", "scene", "tracing"}
    assert set(imported(PACKAGE / "plugins/lobe_bsdf.py")) >= {"reflection", "tracing"}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_up_the_table(path):
    """Within a folder anything goes; everything else is imported from a row above."""
    layers = documented()
    here = room(path.relative_to(PACKAGE).with_suffix("").parts)
    if path.name == "albedo.py" and path.parent == PACKAGE:
        return  # Where something was; kept for programs that import it.
    assert here in layers, f"docs/architecture.md does not list {here}"
    for other in imported(path):
        assert other == here or layers[other] < layers[here], f"{here} imports {other}"


def test_tests_have_the_same_folders():
    """Where the tests of a module are, its own place tells."""
    folders = {path.parent for path in (ROOT / "tests").rglob("test_*.py")} - {ROOT / "tests"}
    assert folders and all((PACKAGE / path.relative_to(ROOT / "tests")).is_dir() for path in folders)


def test_every_documented_room_exists():
    """The table lists nothing that is gone."""
    assert all((PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file() for name in documented())


def test_rendering_loads_no_importers():
    """Most scenes have no mistake, so what would tell of one is loaded when it is needed."""
    code = "import sys, phong_bsdf.scene.rendering; print([name for name in sys.modules if 'importers' in name])"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.stdout == "[]\n", child.stdout + child.stderr
