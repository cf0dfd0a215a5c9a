"""Formulas as MathML, which browsers draw by themselves: no JavaScript, no fonts from a network, nothing to install.

An equation's label says its number: `$$ … $$ (eq-21)` is equation (21), wherever it stands, so that "eq. (21)" in a
docstring stays true where another equation goes.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

COMMAND = re.compile(r"\\\w*")
FUNCTION = re.compile(r"<mi>(ln|log|exp|sin|cos|tan)</mi>(?=(<mo[^>]*>(?:\(|&#x00028;))?)")
logger = logging.getLogger(__name__)


def number_by_label(app: Sphinx, doctree: nodes.document) -> None:
    """Let each equation have the number of its label."""
    for node in doctree.findall(nodes.math_block):
        label = node.get("label") or ""
        if label.startswith("eq-"):
            node["number"] = int(label.removeprefix("eq-"))
            app.env.domains.math_domain.equations[label] = (app.env.docname, node["number"])


def converted(node: nodes.math | nodes.math_block, display: str) -> str:
    """A formula as MathML; a command that the converter passes on as it stands is a warning."""
    written: str = convert(node.astext(), display=display)
    if "\\" in written:
        logger.warning("not understood in a formula: %s", ", ".join(COMMAND.findall(written)), location=node)
    return FUNCTION.sub(spaced, written)


def spaced(function: re.Match[str]) -> str:
    """The name of a function, apart from what is before it and, where no bracket follows, from what is after it."""
    after = "0" if function[2] else "0.17em"
    return f'<mo lspace="0.17em" rspace="{after}">{function[1]}</mo>'


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(converted(node, "inline"))
    raise nodes.SkipNode


def visit_display(translator: Any, node: nodes.math_block) -> None:
    """Write a formula of its own, with its number and a link to it."""
    translator.body.append(translator.starttag(node, "div", CLASS="math notranslate"))
    translator.body.append('<div class="formula">' + converted(node, "block") + "</div>")
    if node["number"]:
        translator.body.append(f'<span class="eqno">({node["number"]})')
        translator.add_permalink_ref(node, "Link to this equation")
        translator.body.append("</span>")
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_display, None))
    app.connect("doctree-read", number_by_label)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
