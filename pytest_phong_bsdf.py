"""Render checks for pytest: the plugin that pytest finds where phong_bsdf is installed.

Every pytest session loads it, so it imports neither Mitsuba nor the package until a test asks for one of its
fixtures; it only chooses the LLVM, which must happen before anything imports Dr.Jit.
"""

import importlib.util
import json
import os
import re
import shlex
import warnings
from dataclasses import fields
from pathlib import Path

import pytest


def _choose_llvm() -> None:
    """What `import phong_bsdf` does first, without the rest of it."""
    package = importlib.util.find_spec("phong_bsdf")
    if package is None or not package.origin:
        return
    spec = importlib.util.spec_from_file_location(
        "_phong_bsdf_llvm", Path(package.origin).with_name("host") / "llvm.py"
    )
    assert spec is not None and spec.loader is not None
    llvm = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(llvm)
    with warnings.catch_warnings():
        # That there is none is said when it is needed.
        warnings.simplefilter("ignore")
        llvm.prepare()


_choose_llvm()

MARKERS = (
    "phong_variants(*names): run the test in each of these variants of Mitsuba",
    "render_check(**options): defaults for the options of the fixture render_check",
)


def pytest_addoption(parser):
    group = parser.getgroup("phong_bsdf", "render checks (phong_bsdf)")
    group.addoption("--phong-update-references", action="store_true", help="Write what is rendered as the references.")
    group.addoption("--phong-report", metavar="DIR", type=Path, help="Write an HTML page for each failure.")
    group.addoption("--phong-variant", action="append", default=[], metavar="NAME",
                    help="Mitsuba variant of tests that do not choose theirs; may be given several times.")  # fmt: skip
    parser.addini("phong_variants", "Mitsuba variants of render checks", type="args", default=["llvm_ad_rgb"])
    parser.addini("phong_references", "Folder of references, beside each test file", default="references")


def pytest_configure(config):
    for marker in MARKERS:
        config.addinivalue_line("markers", marker)
    folder = config.getoption("--phong-report")
    if folder is not None:
        from phong_bsdf.pictures import images
        from phong_bsdf.report import page

        try:
            page.check_installed()
            images.check_folder(folder)
        except (ImportError, ValueError) as error:
            raise pytest.UsageError(f"--phong-report: {error}") from None
        # A test may change the current folder.
        config.option.phong_report = folder.absolute()
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(_Report(folder.absolute()), "phong_bsdf_report")
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Written(), "phong_bsdf_written")


def pytest_generate_tests(metafunc):
    if "phong_variant" not in metafunc.fixturenames:
        return
    marker = metafunc.definition.get_closest_marker("phong_variants")
    names = list(marker.args) if marker else _default_variants(metafunc.config)
    # A single default leaves the name of the test as it is.
    if marker or len(names) > 1:
        metafunc.parametrize("phong_variant", names, indirect=True)


@pytest.fixture
def phong_variant(request):
    """A variant of Mitsuba, set for this test; afterwards Dr.Jit and Mitsuba are as they were."""
    from phong_bsdf.checking.isolation import isolated

    variant = getattr(request, "param", None) or _default_variants(request.config)[0]
    context, refusal = isolated(variant), ""
    try:
        context.__enter__()
    except (ValueError, ImportError) as error:
        refusal = str(error)
    if refusal:
        # Not in the `except`, where pytest would show both.
        pytest.fail(refusal, pytrace=False)
    yield variant
    context.__exit__(None, None, None)


@pytest.fixture
def render_check(request, phong_variant):
    """Fails unless a scene looks like its reference: `render_check("scene.xml", absolute=1e-3)`."""
    return RenderCheck(request, phong_variant)


class RenderCheck:
    """What the fixture `render_check` is; docs/test-authors.md has its options."""

    def __init__(self, request, variant: str):
        self.node, self.config, self.variant = request.node, request.config, variant
        marker = request.node.get_closest_marker("render_check")
        self.defaults = dict(marker.kwargs) if marker else {}
        self.names: list[str] = []

    def __call__(self, scene, name: str | None = None, **options):
        """Render (or take the array `scene`), and compare with the reference `name`."""
        import numpy as np

        from phong_bsdf.checking import references
        from phong_bsdf.scene.rendering import SceneError

        options, known = {**self.defaults, **options}, [field.name for field in fields(references.Options)]
        for unknown in sorted(options.keys() - set(known)):
            pytest.fail(f"render_check: there is no option '{unknown}'; there are {', '.join(known)}", pytrace=False)
        chosen = references.Options(**options)
        if isinstance(scene, str | Path):
            scene = self.scene_file(Path(scene))
        path = self.reference(name)
        if self.config.getoption("--phong-update-references"):
            refusal = ""
            try:
                references.update(path, scene, chosen)
            except ValueError as error:
                refusal = str(error)
            if refusal:
                self.fail(path, refusal, None)
            written = [file for file in references.files(path) if file.is_file()]
            self.node.user_properties += [("phong_reference", str(file)) for file in written]
            return
        outcome, refusal = None, ""
        try:
            outcome = references.check(path, scene, chosen)
        except references.NoReference as error:
            refusal = f"{error}. Make it with: {self.command()}"
        except SceneError as error:
            refusal = str(error)
        except ValueError as error:
            refusal = f"{error}. If the new picture is right, run: {self.command()}"
        if outcome is None:
            # Not in the `except`, where pytest would show both.
            self.fail(path, refusal, None)
        elif not outcome.verdict.passed:
            words = f"{outcome.verdict.words}\nReference: {references.files(path)[0]}"
            if np.isfinite(outcome.actual).all():
                words += f"\nIf the new picture is right, run: {self.command()}"
            self.fail(path, words, outcome)

    def scene_file(self, path: Path) -> Path:
        """A scene's file: beside the test file, like its reference, or else in the current folder."""
        beside = self.node.path.parent / path
        return beside if beside.is_file() else path

    def reference(self, name: str | None) -> Path:
        """Where the reference is, without suffix: beside the test file, the same for all variants."""
        if name is None:
            classes = [node.name for node in self.node.listchain() if isinstance(node, pytest.Class)]
            name = ".".join([*classes, getattr(self.node, "originalname", None) or self.node.name])
            values = getattr(self.node, "callspec", None)
            identity = values.id.split("-") if values else []
            identity = [part for part in identity if part != self.variant]
            name = "-".join([name, *identity])
            name += f"-{self.names.count(name) + 1}" * (name in self.names)
        self.names.append(name)
        folder = self.node.path.parent / self.config.getini("phong_references") / self.node.path.stem
        return folder / _file_name(name)

    def command(self) -> str:
        """What accepts the new picture of this test."""
        # From the folder in which pytest was started: names of tests are from its root.
        file = os.path.relpath(self.node.path, self.config.invocation_params.dir)
        _, colons, test = self.node.nodeid.partition("::")
        return f"pytest --phong-update-references {shlex.quote(file + colons + test)}"

    def fail(self, path: Path, words: str, outcome) -> None:
        """Fail the test with these words; with an `outcome`, and where pages are asked for, with a page."""
        folder, page = self.config.getoption("--phong-report"), ""
        if folder is not None and outcome is not None:
            from phong_bsdf.report import render_check

            # Of the test, not of its reference, which others may share.
            test = re.sub(r"\.py(?=::)|\]$", "", self.node.nodeid)
            page = _file_name(re.sub(r"::|/|\[", "-", test)) + ".html"
            folder.mkdir(parents=True, exist_ok=True)
            render_check.write(folder / page, self.node.nodeid, path.name, outcome)
            words += f"\nPage: {folder / page}"
        failure = {"test": self.node.nodeid, "words": words.split("\n")[0], "page": page}
        self.node.user_properties.append(("phong_failure", json.dumps(failure)))
        pytest.fail(f"{path.name}: {words}", pytrace=False)


class _Report:
    """Lists the failures of all workers on one page."""

    def __init__(self, folder: Path):
        self.folder, self.failures, self.tests = folder, [], 0

    def pytest_runtest_logreport(self, report):
        if report.when != "call":
            return
        self.tests += 1
        for name, value in report.user_properties:
            if name == "phong_failure":
                self.failures.append(tuple(json.loads(value).values()))

    def pytest_sessionfinish(self):
        from phong_bsdf.report import render_check

        self.folder.mkdir(parents=True, exist_ok=True)
        render_check.write_index(self.folder / "index.html", sorted(self.failures), self.tests)

    def pytest_terminal_summary(self, terminalreporter):
        terminalreporter.write_line(f"Render checks: {self.folder / 'index.html'}")


class _Written:
    """Says which references were written."""

    def __init__(self):
        self.paths = []

    def pytest_runtest_logreport(self, report):
        if report.when == "call":
            self.paths += [value for name, value in report.user_properties if name == "phong_reference"]

    def pytest_terminal_summary(self, terminalreporter):
        if self.paths:
            terminalreporter.section("references written")
            # Variants share one.
            for path in sorted(set(self.paths)):
                terminalreporter.write_line(path)


def _file_name(name: str) -> str:
    """A name as one that every file system takes; what differs stays different."""
    return re.sub(r"[^\w.-]", lambda match: f"_{ord(match[0]):02x}", name)


def _default_variants(config) -> list[str]:
    return config.getoption("--phong-variant") or config.getini("phong_variants")
