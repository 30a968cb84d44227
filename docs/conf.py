"""How Sphinx builds these pages: `make docs`."""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import latex2mathml

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
html_show_copyright = False
# Indented blocks are commands and formulas.
highlight_language = "none"
nitpicky = True


def setup(app):
    """Manuals come from the source; formulas become MathML, which browsers show without a script or a network."""
    app.connect("source-read", manuals.insert)
    app.add_html_math_renderer("mathml", inline_renderers=(visit_math, None), block_renderers=(visit_math, None))


def visit_math(translator, node):
    """Write a formula, in a line or of its own."""
    translator.body.append(latex2mathml.tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode
