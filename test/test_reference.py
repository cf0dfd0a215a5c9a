"""The generated pages of docs/reference are what the code's tables say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_reference_pages_are_up_to_date(tmp_path: Path) -> None:
    # In a process of its own: other tests register effects.
    subprocess.run([sys.executable, "docs/_ext/reference_tables.py", str(tmp_path)], cwd=ROOT, check=True)
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    committed = {name: (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8") for name in made}
    assert {"topics.md", "parameters.md", "effects.md"} <= made.keys()
    assert made == committed, "run: python docs/_ext/reference_tables.py docs/reference"
