"""`phong-bsdf explore`."""

import webbrowser
from pathlib import Path

import click

from .session import errors


@click.command()
@click.option("-o", "--output", "path", default="phong-explorer.html", show_default=True,
              type=click.Path(path_type=Path), help="The page, an .html file.")  # fmt: skip
@click.option("--open", "opens", is_flag=True, help="Show it in the browser.")
def explore(path, opens):
    """Write the explorer: a page that shades a ball live, with sliders for everything in the formula."""
    with errors():
        from ..pictures import images
        from ..report import explorer

        if path.suffix.lower() != ".html" or path.is_dir():
            raise ValueError(f"'{path}': the page must be a file that ends in .html")
        images.check_folder(path.parent)
        path.parent.mkdir(parents=True, exist_ok=True)
        explorer.write(path)
    click.echo(f"The page: {path}")
    if opens and not webbrowser.open(path.resolve().as_uri()):
        click.echo("There is no browser that could show it.", err=True)
