"""The public interface: what docs/python.md says of it is there, complete, typed, and all that the pages use."""

import ast
import importlib
import inspect
import re
import subprocess
import sys

import pytest

import phong_bsdf
from helpers import ROOT
from helpers.documents import PAGES, blocks

PAGE = ROOT / "docs/python.md"
PUBLIC = re.findall(r"^<!-- manual of (phong_bsdf\.[\w.]+) -->$", PAGE.read_text(), re.M)
NAMES = [(module, name) for module in PUBLIC for name in importlib.import_module(module).__all__]

# Where `phong_bsdf.reflection.albedo` was.
OLD = "phong_bsdf.albedo"

# What `Assignment.check` hands to `Assignment.picture_of`; the page says that it is internal.
OPAQUE = {"Picture", "Explanation"}


@pytest.fixture
def manuals(monkeypatch):
    """The module of the pages that writes the manuals."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("manuals")


def the(module, name):
    return getattr(importlib.import_module(module), name)


def functions(value):
    """What can be called: a function, or the constructor, methods and properties of a class, each with its name."""
    if inspect.isfunction(value):
        return [(value.__name__, value)]
    unwrapped = {
        name: getattr(part, "fget", None) or getattr(part, "func", None) or getattr(part, "__func__", part)
        for name, part in vars(value).items()
        if not name.startswith("_") or (name == "__init__" and not hasattr(value, "__dataclass_fields__"))
    }
    return [(f"{value.__name__}.{name}", part) for name, part in unwrapped.items() if inspect.isfunction(part)]


def annotations(value):
    """What the parameters, results and fields of a public name are said to be; `empty` where nothing is said."""
    found = list(vars(value).get("__annotations__", {}).values()) if inspect.isclass(value) else []
    for name, function in functions(value):
        signature = inspect.signature(function)
        parameters = list(signature.parameters.values())
        found += [p.annotation for p in (parameters[1:] if inspect.isclass(value) else parameters)]
        found += [] if name.endswith("__init__") else [signature.return_annotation]
    return found


def section(module):
    """The part of the page about a module."""
    return re.search(rf"^## {re.escape(module)}\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.M | re.S)[1]


# The names -----------------------------------------------------------------------------------------------------


def test_public_modules_are_those_that_declare_it():
    """The page has every module with an `__all__`, by its heading and its mark; others have none."""
    declared = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in (ROOT / "phong_bsdf").rglob("*.py")
        if re.search(r"^__all__\b", path.read_text(), re.M)
    }
    assert declared == {*PUBLIC, "phong_bsdf", OLD}
    assert re.findall(r"^## (.*)$", PAGE.read_text(), re.M) == PUBLIC


@pytest.mark.parametrize(("module", "name"), NAMES, ids=lambda part: part)
def test_it_has_a_docstring(manuals, module, name):
    """So have its methods and properties; a dataclass without one would get its signature as that."""
    value = the(module, name)
    if not callable(value):
        assert manuals.described(importlib.import_module(module), name).partition("```\n\n")[2].strip()
        return
    assert value.__doc__ and not value.__doc__.startswith(f"{name}(")
    # What a constructor takes may be told with the class.
    assert all(function.__doc__ for place, function in functions(value) if not place.endswith("__init__"))


@pytest.mark.parametrize(("module", "name"), NAMES, ids=lambda part: part)
def test_it_is_typed(module, name):
    """Every parameter and every result; the types of the package that it speaks of are public, too."""
    value = the(module, name)
    found = annotations(value) if callable(value) else []
    assert inspect.Signature.empty not in found
    said = " ".join(inspect.formatannotation(annotation) for annotation in found)
    assert set(re.findall(r"phong_bsdf[\w.]*\.(\w+)", said)) <= {public for _, public in NAMES} | OPAQUE


@pytest.mark.parametrize(("module", "name"), NAMES, ids=lambda part: part)
def test_its_manual_is_on_the_page(manuals, module, name):
    """A heading, what it is, and all that it takes."""
    whole = manuals.names(importlib.import_module(module))
    manual = re.search(rf"^### {name}\n(.*?)(?=^### |\Z)", whole, re.M | re.S)[1]
    value = the(module, name)
    words = set(re.findall(r"\w+", manual))
    if callable(value):
        assert " ".join(inspect.getdoc(value).split()) in " ".join(manual.split())
        assert set(vars(value).get("__annotations__", {})) - {"return"} <= words
        for place, function in functions(value):
            assert {place.rpartition(".")[2], *inspect.signature(function).parameters} <= words


@pytest.mark.parametrize("module", PUBLIC)
def test_there_is_an_example(module):
    """Of each function, in the module's section; tests/test_documents.py runs it."""
    text = section(module)
    examples = "\n".join(re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S))
    for name in importlib.import_module(module).__all__:
        if inspect.isfunction(the(module, name)) or name in ("Assignment", "Choice", "Options", "Unknown"):
            assert re.search(rf"\b{name}\(", examples), f"no example calls {name}"


# What uses them ------------------------------------------------------------------------------------------------


def imported(code):
    """(module, name) of all that a block of Python takes from the package: by import, or as an attribute."""
    tree, modules = ast.parse(code), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "phong_bsdf":
                    modules[alias.asname or "phong_bsdf"] = alias.name if alias.asname else "phong_bsdf"
                    yield alias.name, None
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "phong_bsdf":
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in PUBLIC:
                    modules[alias.asname or alias.name] = whole
                yield (whole, None) if whole in PUBLIC else (node.module, alias.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            yield modules[node.value.id], node.attr


def test_imports_are_read():
    """Each way to write one."""
    code = "import phong_bsdf\nfrom phong_bsdf.checking import grading as g\nfrom phong_bsdf.tracing import sums\n"
    found = set(imported(code + "g.Options()\nphong_bsdf.sweep\nimport phong_bsdf.host.llvm"))
    assert found == {
        ("phong_bsdf", None), ("phong_bsdf.checking.grading", None), ("phong_bsdf.tracing", "sums"),
        ("phong_bsdf.host.llvm", None), ("phong_bsdf.checking.grading", "Options"), ("phong_bsdf", "sweep"),
    }  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_import_nothing_internal(page):
    """What README and docs import, or name with its module, is public."""
    for block in blocks(page):
        for module, name in imported(block.text) if block.language == "python" else ():
            assert module in (*PUBLIC, "phong_bsdf"), f"{block.place}: {module} is internal"
            assert name is None or name in importlib.import_module(module).__all__, f"{block.place}: {module}.{name}"
    prose = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    for dotted in re.findall(r"(?<![\w/.])phong_bsdf(?:\.\w+)+", prose):
        module, _, name = dotted.rpartition(".")
        public = dotted in PUBLIC or any(module == m and name in importlib.import_module(m).__all__ for m in PUBLIC)
        assert public or dotted == "phong_bsdf.__version__", f"{page.name}: {dotted} is internal"


def test_importing_the_package_loads_little():
    """Mitsuba, and what registers the plugins: no module of the interface, nothing that only some need."""
    code = "import sys; before = set(sys.modules); import phong_bsdf; print(*sorted(set(sys.modules) - before))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    loaded = child.stdout.split()
    ours = {name for name in loaded if name.split(".")[0] == "phong_bsdf"}
    assert ours == {"phong_bsdf", "phong_bsdf.host", "phong_bsdf.host.llvm", "phong_bsdf.host.registry"}
    assert {name.split(".")[0] for name in loaded} - sys.stdlib_module_names == {"phong_bsdf", "mitsuba", "drjit"}


def test_the_old_name_of_albedo_warns(monkeypatch):
    """It is the same function, for programs of version 0.1."""
    from phong_bsdf.reflection import albedo

    monkeypatch.delitem(sys.modules, OLD, raising=False)
    with pytest.warns(DeprecationWarning, match=r"phong_bsdf\.reflection\.albedo"):
        old = importlib.import_module(OLD)
    assert old.directional_albedo is albedo.directional_albedo
    assert phong_bsdf.albedo is old
