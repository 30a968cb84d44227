"""Pages in a Chromium of the system, without a network: the fixture `browser` of conftest.py launches it."""

import contextlib
import shutil

import pytest


@contextlib.contextmanager
def launched():
    """A browser; skips the test where there is none."""
    playwright = pytest.importorskip("playwright.sync_api")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on this system")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextlib.contextmanager
def opened(browser, path, ready, *, width=1000, height=1200, visits=()):
    """The page at `path` once `ready` is there; in the end only the `visits` were asked for, and nothing went wrong."""
    context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
    page = context.new_page()
    asked, wrong = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(path.as_uri())
    page.wait_for_selector(ready)
    yield page
    context.close()
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri(), *visits]
    assert wrong == []
