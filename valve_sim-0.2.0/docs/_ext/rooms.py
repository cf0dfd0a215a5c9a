"""Draws the rooms of a package and who imports whom, from the sources: `python docs/_ext/rooms.py docs/images`.

A room stands above all rooms that it imports. Of imports that follow from others (A imports B, B imports C, A imports
C) no arrow is drawn.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
from collections.abc import Mapping
from functools import cache
from html import escape
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
WIDTH, HEIGHT, APART, BETWEEN = 168, 62, 16, 34
"""Of a box, of the space between boxes in a row, and of that between rows; px."""
STYLE: Final = 'stroke="#5f6f8f"'
Rooms = dict[str, set[str]]


def imported_by(path: Path) -> set[str]:
    """Modules that a source imports at run time, by their full names."""
    found: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    of_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in of_types:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def rooms_of(package: Path) -> Rooms:
    """Each room, a folder of the package or `api.py`, with the rooms that it imports."""
    name = ".".join(package.relative_to(ROOT).parts)
    folders = [path.parent for path in package.glob("*/__init__.py")] + list(package.glob("api.py"))
    rooms = {path.stem: {path} if path.suffix else set(path.rglob("*.py")) for path in folders}
    return {
        room: {
            other
            for source in sources
            for module in imported_by(source)
            for other in rooms
            if other != room and f"{module}.".startswith(f"{name}.{other}.")
        }
        for room, sources in sorted(rooms.items())
    }


def without_what_follows(rooms: Mapping[str, set[str]]) -> Rooms:
    """Only the imports that do not follow from others."""

    @cache
    def below(room: str) -> frozenset[str]:
        return frozenset(rooms[room]).union(*(below(other) for other in rooms[room]))

    return {room: {own for own in found if not any(own in below(other) for other in found)}
            for room, found in rooms.items()}  # fmt: skip


def levels_of(rooms: Mapping[str, set[str]]) -> dict[str, int]:
    """How many rooms are below each, one above the other."""

    @cache
    def level(room: str) -> int:
        return 1 + max(map(level, rooms[room]), default=-1)

    return {room: level(room) for room in rooms}


def words_of(package: Path, room: str) -> list[str]:
    """The first words of what a room says it is, in at most two lines."""
    source = package / room / "__init__.py" if (package / room).is_dir() else package / f"{room}.py"
    said = (ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or "").replace("`", "")
    said = re.sub(r"^[^:.]{1,14}: ", "", said)  # its name, before what it is
    return textwrap.wrap(re.split(r"[:.;(\n]| from |, f| and a ", said)[0], 27, max_lines=2, placeholder=" …")


def drawn(package: Path) -> str:
    """The picture as SVG."""
    rooms = rooms_of(package)
    levels = levels_of(rooms)
    rows = [sorted(room for room in rooms if levels[room] == number) for number in range(max(levels.values()), -1, -1)]
    width = APART + max(map(len, rows)) * (WIDTH + APART)
    height = len(rows) * (HEIGHT + BETWEEN) - BETWEEN + 2 * APART
    at = {}
    for number, row in enumerate(rows):
        left = (width - len(row) * (WIDTH + APART) + APART) / 2
        for place, room in enumerate(row):
            at[room] = (left + place * (WIDTH + APART), APART + number * (HEIGHT + BETWEEN))
    title = f"The rooms of {'.'.join(package.relative_to(ROOT).parts)} and who imports whom"
    arrow = '<path d="M0 0 10 5 0 10z" fill="#5f6f8f"/>'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" role="img">',
        f"<title>{escape(title)}</title>",
        f'<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        f'orient="auto">{arrow}</marker></defs>',
        f'<rect width="{width}" height="{height}" rx="8" fill="#ffffff"/>',
    ]
    for room, others in without_what_follows(rooms).items():
        for other in sorted(others):
            (x, y), (to_x, to_y) = at[room], at[other]
            lines.append(
                f'<line x1="{x + WIDTH / 2:g}" y1="{y + HEIGHT}" x2="{to_x + WIDTH / 2:g}" y2="{to_y}" {STYLE} '
                'stroke-width="1.5" marker-end="url(#a)"/>'
            )
    for room, (x, y) in at.items():
        lines.append(f'<rect x="{x:g}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="7" fill="#eef3fb" {STYLE}/>')
        middle = f'x="{x + WIDTH / 2:g}" text-anchor="middle"'
        lines.append(f'<text {middle} y="{y + 20}" font-size="15" font-weight="bold" fill="#1f2a44">{room}</text>')
        lines += [
            f'<text {middle} y="{y + 37 + 14 * number}" font-size="11" fill="#3c4a66">{escape(words)}</text>'
            for number, words in enumerate(words_of(package, room))
        ]
    return "\n".join([*lines, "</svg>", ""])


PICTURES: Final = {"rooms.svg": ROOT / "valve_sim", "identification.svg": ROOT / "valve_sim" / "identification"}


if __name__ == "__main__":
    for name, package in PICTURES.items():
        (Path(sys.argv[1]) / name).write_text(drawn(package), encoding="utf-8")
