"""How Sphinx builds these pages: `make docs`."""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.addnodes import download_reference

sys.path.insert(0, str(Path(__file__).parent))

import manuals

import phong_bsdf

project = "phong_bsdf"
author = "the phong_bsdf authors"
version = release = phong_bsdf.__version__
html_title = f"phong_bsdf {version}"

extensions = ["myst_parser", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath"]
# As other viewers of Markdown have it: ```math is a formula, and headings can be linked to.
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_use_index = False
# Summaries are fetched, which browsers forbid to pages that are files.
html_show_search_summary = False
html_show_copyright = False
# Indented blocks are commands and formulas.
highlight_language = "none"
nitpicky = True


def setup(app):
    """Manuals come from the source; formulas become MathML, which browsers show without a script or a network."""
    app.connect("source-read", manuals.insert)
    app.add_html_math_renderer("mathml", inline_renderers=(formula, None), block_renderers=(displayed_formula, None))
    app.add_node(download_reference, override=True, html=(open_file, close_file))


def formula(translator, node):
    """Write a formula within a line."""
    translator.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def displayed_formula(translator, node):
    """Write a formula that has a line of its own."""
    translator.body.append(f'<div class="formula">{latex2mathml.tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def open_file(translator, node):
    """Link to a file that is no page, the explorer or a source, so that the browser shows it instead of saving it."""
    target = f"{translator.builder.dlpath}/{node['filename']}"
    translator.body.append(translator.starttag(node, "a", "", CLASS="reference internal", href=target))


def close_file(translator, node):
    """The end of such a link."""
    translator.body.append("</a>")
