"""The pages hold together: links, anchors, equation numbers, and what they say of files that others read."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "docs" / "closing_the_loop.ipynb"
PAGES = sorted(
    path
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "bags").glob("*.md"), NOTEBOOK)
    if "api" not in path.parts
)
ELSEWHERE = re.compile(r"^(https?|mailto):")
SHIPPED = ("valve_sim", "test", "benchmarks", "docs", "config", "launch", "tools", "bags", ".github")


def text_of(page: Path) -> str:
    """What a person reads of a page, or of the words of a notebook; without its code."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return re.sub(r"^(```+).*?^\1$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What can be linked to in a page: its headings, as GitHub and MyST call them."""
    headings = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path, text: str) -> Iterator[str]:
    """Links of a page to files or headings that are not there; links to elsewhere are not followed."""
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", text)):
        if ELSEWHERE.match(target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            yield target


def equations() -> list[int]:
    """The numbers of the theory's equations, page after page."""
    pages = sorted((ROOT / "docs" / "theory").glob("*.md"))
    return [int(n) for page in pages for n in re.findall(r"^\$\$ \(eq-(\d+)\)$", page.read_text("utf-8"), re.MULTILINE)]


def test_links_lead_somewhere() -> None:
    broken = {str(page.relative_to(ROOT)): list(broken_links(page, text_of(page))) for page in PAGES}
    assert {page: links for page, links in broken.items() if links} == {}
    text = (
        "[a](index.md) [b](gone.md) [c](glossary.md#model) [d](glossary.md#gone) [e](https://nowhere.invalid) `[f](x)`"
    )
    assert list(broken_links(ROOT / "docs" / "architecture.md", text)) == ["gone.md", "glossary.md#gone"]


def test_every_equation_that_is_cited_exists_once() -> None:
    numbers = equations()
    assert len(numbers) == len(set(numbers)) > 50
    sources = [*PAGES, *(path for folder in SHIPPED for path in (ROOT / folder).rglob("*.py"))]
    cited = [
        (str(source.relative_to(ROOT)), int(number))
        for source in sources
        for words in re.findall(r"\beqs?\. (\(\d+\)(?:(?:,| and| to) \(\d+\))*)", source.read_text(encoding="utf-8"))
        for number in re.findall(r"\d+", words)
    ]
    assert cited, "nothing cites the theory"
    assert [(where, number) for where, number in cited if number not in numbers] == []


@pytest.mark.parametrize(
    ("heading", "package"), [("Inside identification", "identification"), ("Inside the model", "model")]
)
def test_every_room_is_described(heading: str, package: str) -> None:
    section = text_of(ROOT / "docs" / "architecture.md").split(f"## {heading}\n")[1].split("\n## ")[0]
    listed = set(re.findall(r"`(\w+)/?`", " ".join(re.findall(r"^\| (`.*?) \|", section, re.MULTILINE))))
    inside = (ROOT / "valve_sim" / package).glob("*")
    rooms = {path.stem for path in inside if path.is_dir() or (path.suffix == ".py" and package == "model")}
    assert rooms - {"__init__", "__pycache__", "core_types", "errors"} == listed


@pytest.mark.long
@pytest.mark.parametrize("name", ["rooms.svg", "identification.svg"])
def test_the_pictures_of_rooms_are_drawn_from_the_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    rooms = importlib.import_module("rooms")
    kept = (ROOT / "docs" / "images" / name).read_text(encoding="utf-8")
    assert kept == rooms.drawn(rooms.PICTURES[name]), "draw it again: python docs/_ext/rooms.py docs/images"


def test_the_reading_list_of_the_code_names_what_is_there() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d+ \| `(valve_sim/\S+)` \| (.*?) \|", page, re.MULTILINE)
    assert len(rows) == 13
    for place, words in rows:
        source = (ROOT / place).read_text(encoding="utf-8")
        for name in re.findall(r"`(\w+)`", words):
            assert re.search(rf"^(def|class) {name}\b", source, re.MULTILINE), f"{place}: {name}"


def test_every_message_of_troubleshooting_is_in_the_code() -> None:
    """Its fixed words, in their order, are one text of the source; "…" stands for what is filled in."""
    page = (ROOT / "docs" / "how_to" / "troubleshooting.md").read_text(encoding="utf-8")
    messages = re.findall(r"^\| `(.*?)` \| ", page, re.MULTILINE)
    assert len(messages) > 30
    texts = "\0".join(text for path in (ROOT / "valve_sim").rglob("*.py") for text in texts_of(path))
    gone = [
        message
        for message in messages
        if not re.search("[^\0]*".join(re.escape(part.strip()) for part in message.split("…") if part.strip()), texts)
    ]
    assert gone == []


def texts_of(source: Path) -> Iterator[str]:
    """Every text of a source, without what is filled in; docstrings are none."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


@pytest.mark.parametrize("diff", sorted((ROOT / "docs" / "examples").glob("*.diff")), ids=lambda path: path.stem)
def test_a_diff_of_the_how_tos_applies(diff: Path) -> None:
    """What it does is tested in a copy, by long tests."""
    done = subprocess.run(
        ["git", "apply", "--check", str(diff)], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
    )
    assert not done.returncode, f"{done.stderr}the files that it changes are others now: make the diff again"
