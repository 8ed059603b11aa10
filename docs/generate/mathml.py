"""Formulas as MathML, which browsers draw by themselves: a page then needs no script and no font from elsewhere."""

from html import escape

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata
from sphinx.writers.html5 import HTML5Translator


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    number = node.get("number")
    label = f'<span class="eqno">({escape(str(number))})</span>' if number else ""
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div class="math"{_identity(node)}>{label}{formula}</div>')
    raise nodes.SkipNode


def _identity(node: nodes.Element) -> str:
    return f' id="{escape(node["ids"][0])}"' if node["ids"] else ""


def setup(app: Sphinx) -> ExtensionMetadata:
    """Called by Sphinx, which has the extension under the name ``generate.mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
