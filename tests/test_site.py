"""`make docs`: builds without a warning, needs no network, and holds the manuals that the source holds."""

import contextlib
import importlib
import re
import subprocess
import sys

import pytest

from helpers import ROOT
from phong_bsdf.cli import main
from phong_bsdf.host.registry import PLUGINS
from phong_bsdf.importers import catalogue

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the pages, built as `make docs` builds them."""
    recipe = re.search(r"^\t@\$\(BIN\)/python (-m sphinx .*)$", (ROOT / "Makefile").read_text(), re.M)[1]
    folder = tmp_path_factory.mktemp("docs")
    command = [str(folder) if word == "out/docs" else word for word in recipe.split()]
    result = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


@contextlib.contextmanager
def shown(browser, path, width=1200):
    """The page in a browser without a network; in the end it has asked for nothing but files beside it."""
    context = browser.new_context(viewport={"width": width, "height": 900}, offline=True)
    page = context.new_page()
    asked, wrong = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("requestfailed", lambda request: wrong.append(request.url))
    page.goto(path.as_uri())
    yield page
    context.close()
    assert len(asked) > 3 and all(url.startswith(("data:", path.parent.as_uri())) for url in asked), asked
    assert wrong == []


def test_every_page_is_listed(site):
    """Each Markdown file is a page, and the first page leads to it."""
    first = (site / "index.html").read_text()
    for page in DOCS.glob("*.md"):
        assert (site / f"{page.stem}.html").is_file()
        assert page.stem == "index" or f'href="{page.stem}.html"' in first


@pytest.mark.slow
def test_pages_need_no_network_and_fit_a_phone(site, browser):
    """Each is complete in itself; nothing but code and tables scrolls sideways."""
    for page in DOCS.glob("*.md"):
        with shown(browser, site / f"{page.stem}.html", width=390) as window:
            assert window.evaluate("document.documentElement.scrollWidth") <= 390, page.name
            broken = "() => [...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)"
            assert window.evaluate(broken) == []


def test_search_works_without_a_server(site, browser):
    """It finds the pages, and asks for nothing that a browser forbids to files."""
    with shown(browser, site / "search.html") as page:
        page.locator(".sidebar-search").fill("mirrorblend")
        page.locator(".sidebar-search").press("Enter")
        page.locator("#search-results li").first.wait_for()
        page.wait_for_load_state("networkidle")
        assert "Plugins" in page.locator("#search-results").inner_text()


def test_formulas_are_drawn(site, browser):
    """Fractions have a height, and nobody sees LaTeX."""
    with shown(browser, site / "model.html") as page:
        assert page.locator("math").count() == (DOCS / "model.md").read_text().count("```math")
        fraction = page.locator("math mfrac").first
        letter = page.locator("math mi").first
        assert fraction.bounding_box()["height"] > 1.5 * letter.bounding_box()["height"]
        assert not re.search(r"\\(frac|cdot|max|pi)\b", page.locator("article").inner_text())


def test_manuals_of_the_plugins(site, browser):
    """All are there; tables of the docstrings are tables, examples are code, formulas stay as they are typed."""
    with shown(browser, site / "plugins.html") as page:
        assert page.locator("article h2").all_inner_texts() == list(PLUGINS)
        for plugin, parameters in (("phong", "kd ks p"), ("mirrorblend", "km bsdf"), ("whitted", "convention shadows")):
            section = page.locator(f"section#{plugin}")
            assert set(parameters.split()) <= set(section.locator("tbody td:first-child").all_inner_texts())
            assert re.search(rf'<(bsdf|integrator) type="{plugin}">', section.locator(".highlight-xml").inner_text())
        formula = page.locator("section#blinnphong pre").first.inner_text()
        assert formula.strip() == "L = k_d I max(0, n.l) + k_s I max(0, n.h)^p,    h = (v + l) / |v + l|,"
        assert page.locator(".problematic, .system-message").count() == 0


@pytest.mark.parametrize("plugin", PLUGINS)
def test_the_catalogue_has_what_the_manuals_have(plugin):
    """The errors about misspelt parameters list those of this package's plugins."""
    source = (ROOT / f"phong_bsdf/plugins/{plugin}.py").read_text()
    rows = re.findall(r"^    (\w+)  .*(?:>=|\[0|boolean|number|integer|course)", source, re.M)
    assert len(rows) > 0 and set(rows) <= set(catalogue.PLUGINS[PLUGINS[plugin]][plugin].split())


def test_manuals_of_the_commands(site):
    """Each command, with each of its options."""
    text = (site / "commands.html").read_text()
    for name, command in main.commands.items():
        section = text.partition(f'<section id="{name}">')[2].partition("</section>")[0]
        assert f"Usage: phong-bsdf {name}" in section
        assert all(option in section for p in command.params if p.param_type_name == "option" for option in p.opts)


def test_manuals_of_the_public_modules(site):
    """Each name of each module has a heading below that of the module; what is wrong in them would be a warning."""
    text = (site / "python.html").read_text()
    for module in re.findall(r"^<!-- manual of (phong_bsdf\S+) -->$", (DOCS / "python.md").read_text(), re.M):
        section = re.split(r"<h2>", text.partition(f"<h2>{module}<")[2])[0]
        headings = re.findall(r"<h3>(\w+)<", section)
        assert sorted(headings) == sorted(importlib.import_module(module).__all__), module
