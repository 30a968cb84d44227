"""Writes docs/explorer/index.html and, where there is a Chromium, docs/images/explorer.png: `make explorer`."""

import shutil
from pathlib import Path

from phong_bsdf.report import explorer

DOCS = Path(__file__).parent
PAGE = DOCS / "explorer/index.html"
PICTURE = DOCS / "images/explorer.png"


def picture(chromium: str) -> None:
    """A picture of the page as it starts."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(PAGE.resolve().as_uri())
        page.wait_for_selector("#picture[data-ready]")
        page.screenshot(path=PICTURE)
        browser.close()


def main():
    """Write the page, then its picture."""
    PAGE.parent.mkdir(exist_ok=True)
    explorer.write(PAGE)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        print(f"There is no Chromium on this system: {PICTURE} stays as it is.")
    else:
        picture(chromium)


if __name__ == "__main__":
    main()
