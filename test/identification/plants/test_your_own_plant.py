"""The examples of docs/how_to/your_own_plant.md run as they stand, and say what the page says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "how_to" / "your_own_plant.md"


def test_the_examples_on_the_page_run(capsys):
    names = {"__name__": "example"}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(code, str(PAGE), "exec"), names)
    plain, without, erring = capsys.readouterr().out.strip().splitlines()
    assert plain == erring == "The model lacks radiation."
    assert without.startswith("Something acts that no effect of the catalogue explains.")
