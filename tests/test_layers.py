"""The layers of docs/architecture.md: a module imports only from lower ones."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "phong_bsdf"


def documented():
    """Module -> layer, from the table in docs/architecture.md."""
    layers = {}
    for row in re.findall(r"^\| (\d+) \| ([^|]*) \|", (ROOT / "docs/architecture.md").read_text(), re.M):
        for name in re.findall(r"`([\w/.]+)`", row[1]):
            layers[name.removesuffix(".py").rstrip("/")] = int(row[0])
    return layers


def module_of(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imported(path):
    """Modules of the package that `path` imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("phong_bsdf")):
            parts = (node.module or "").removeprefix("phong_bsdf").strip(".").split(".")
            if path.parent != PACKAGE and node.level == 1:
                yield path.parent.name
            elif parts == [""]:
                yield from ("__init__" if a.name.startswith("__") else a.name for a in node.names)
            else:
                yield parts[0]


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down(path):
    """Within a folder anything goes; everything else is imported from below."""
    layers = documented()
    module = module_of(path)
    assert module in layers, f"docs/architecture.md does not list {module}"
    for other in imported(path):
        assert layers[other] < layers[module] or other == module, f"{module} imports {other}"


def test_every_documented_module_exists():
    """The table lists no module that is gone."""
    assert all((PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file() for name in documented())


def test_rendering_loads_no_importers():
    """Most scenes have no mistake, so what would tell of one is loaded when it is needed."""
    code = "import sys, phong_bsdf.rendering; print([name for name in sys.modules if 'importers' in name])"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.stdout == "[]\n", child.stdout + child.stderr
