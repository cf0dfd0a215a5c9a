"""The reference pages of the station are what its tables say."""

from __future__ import annotations

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_pages_are_up_to_date() -> None:
    pages = runpy.run_path(str(DOCS / "_ext" / "station_tables.py"))["pages"]()
    committed = {name: (DOCS / "reference" / name).read_text(encoding="utf-8") for name in pages}
    assert committed == pages, "run: python docs/_ext/station_tables.py docs/reference"
