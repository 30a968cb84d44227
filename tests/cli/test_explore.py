"""`phong-bsdf explore`: writes the page and opens it. What the page does is in tests/report/test_explorer.py."""

import os
import subprocess
import sys

from click.testing import CliRunner

from helpers import ROOT
from phong_bsdf.cli import main


def test_opens_in_the_browser(tmp_path):
    """`--open` hands the page to the user's browser; here one that notes what it is given."""
    browser, noted = tmp_path / "browser", tmp_path / "noted"
    browser.write_text(f'#!/bin/sh\necho "$1" > {noted}\n')
    browser.chmod(0o755)
    command = [sys.executable, "-m", "phong_bsdf", "explore", "--open", "-o", str(tmp_path / "page.html")]
    child = subprocess.run(command, env={**os.environ, "BROWSER": f"{browser} %s"}, capture_output=True, text=True)
    assert (child.returncode, child.stderr) == (0, "")
    assert noted.read_text().strip() == (tmp_path / "page.html").as_uri()


def test_refuses_what_is_no_page(tmp_path):
    """Before anything is written."""
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "file").write_text("")
    for wrong in ("page.txt", "folder.html", "file/page.html"):
        result = CliRunner().invoke(main, ["explore", "-o", str(tmp_path / wrong)])
        assert result.exit_code == 2 and result.stderr.startswith("Error: '")


def test_needs_no_more_than_the_package(tmp_path, monkeypatch):
    """None of its extras."""
    for package in ("matplotlib", "scipy"):
        monkeypatch.setitem(sys.modules, package, None)
    result = CliRunner().invoke(main, ["explore", "-o", str(tmp_path / "page.html")])
    assert (result.exit_code, result.stderr) == (0, "")


def test_page_in_the_documents_is_current(tmp_path):
    """docs/explorer/index.html is what the command writes; `make explorer` mends it."""
    path = tmp_path / "new" / "page.html"
    assert CliRunner().invoke(main, ["explore", "-o", str(path)]).exit_code == 0
    assert (ROOT / "docs/explorer/index.html").read_text() == path.read_text()
