"""The example of docs/how_to/your_own_plant.md runs as it stands, and says what the page says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "how_to" / "your_own_plant.md"


def test_the_example_on_the_page_runs(capsys):
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert code is not None
    exec(compile(code[1], str(PAGE), "exec"), {"__name__": "example"})
    assert capsys.readouterr().out.strip() == "The model lacks radiation."
