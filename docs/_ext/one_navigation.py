"""Furo's navigation, built once: it shows all pages on each of six hundred, and was two thirds of a build's work.

On a page the same tree has other links, relative to that page, and is open on the way to it.
"""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from furo.navigation import get_navigation_tree
from sphinx.application import Sphinx
from sphinx.environment.adapters.toctree import TocTree
from sphinx.util.osutil import relative_uri

SHOWN = {"collapse": False, "titles_only": True, "maxdepth": -1, "includehidden": True}
"""What Furo shows of the contents."""


@cache
def of_no_page(app: Sphinx) -> Element:
    """The navigation with links that start at the top folder, closed."""
    contents = TocTree(app.env).get_toctree_for(app.config.root_doc, app.builder, **SHOWN)
    written = get_navigation_tree(app.builder.render_partial(contents)["fragment"])
    return ElementTree.fromstring(f"<div>{written}</div>")


def opened(branch: Element, page: str) -> bool:
    """Mark the way to a page as Sphinx and Furo do; whether the page is in this branch."""
    is_page = branch.get("href") == page
    is_on_way = any([opened(child, page) for child in branch]) or is_page
    if is_page:
        branch.set("href", "#")
    if is_on_way and branch.tag in ("a", "li", "ul"):
        here = " current-page" if branch.find("a[@href='#']") is not None else ""
        branch.set("class", f"{branch.get('class', '')} current{here}".lstrip())
    box = branch.find("input")
    if is_on_way and box is not None:
        box.set("checked", "")
    return is_on_way


def of_page(closed: Element, page: str) -> str:
    """The navigation as a page shows it."""
    tree = deepcopy(closed)
    opened(tree, page)
    for link in tree.iter("a"):
        if link.get("href") != "#":
            link.set("href", relative_uri(page, link.get("href", "")))
    return "".join(ElementTree.tostring(part, encoding="unicode", method="html") for part in tree)


def leave_out(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Let Furo build an empty tree."""
    context["toctree"] = lambda **_: ""


def put_in(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Put the tree where Furo's template takes it from."""
    context["furo_navigation_tree"] = of_page(of_no_page(app), app.builder.get_target_uri(pagename))


def setup(app: Sphinx) -> dict[str, bool]:
    """Come before Furo and after it."""
    app.connect("html-page-context", leave_out, priority=400)
    app.connect("html-page-context", put_in, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
