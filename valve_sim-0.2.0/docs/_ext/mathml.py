"""Formulas as MathML, which browsers draw by themselves: no JavaScript, no fonts from a network, nothing to install.

An equation's label says its number: `$$ … $$ (eq-21)` is equation (21), wherever it stands. Each page counts on from
its first label, and a label that does not agree with the count is a warning, so that "eq. (21)" in a docstring stays
true.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

LABEL = re.compile(r"\(eq-(\d+)\)\s*$", re.MULTILINE)
COMMAND = re.compile(r"\\\w*")
FUNCTION = re.compile(r"<mi>(ln|log|exp|sin|cos|tan)</mi>(?=(<mo[^>]*>(?:\(|&#x00028;))?)")
logger = logging.getLogger(__name__)


def count_from_first_label(app: Sphinx, docname: str, source: list[str]) -> None:
    """Let the equations of a page be numbered from its first label on."""
    first = LABEL.search(source[0])
    if first is not None:
        for _ in range(int(first[1]) - 1):
            app.env.new_serialno("eqno")


def labels_are_numbers(app: Sphinx, env: BuildEnvironment) -> None:
    """Warn of labels that do not say their number."""
    for label, (docname, number) in env.domains.math_domain.equations.items():
        if label.startswith("eq-") and label != f"eq-{number}":
            logger.warning("equation %s is number %s of its page", label, number, location=docname)


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
    app.connect("source-read", count_from_first_label)
    app.connect("env-check-consistency", labels_are_numbers)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
