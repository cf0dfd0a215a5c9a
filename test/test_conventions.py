"""The files by which editors, commits and a public CI use the Makefile name targets that there are.

None of these programs runs here: what a container, pre-commit or a workflow does with the files is untested.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
WORKFLOW, HOOKS, CONTAINER = ".github/workflows/ros.yml", ".pre-commit-config.yaml", ".devcontainer/devcontainer.json"


def is_target(name: str) -> bool:
    """Whether the Makefile has a rule of this name."""
    rules = MAKEFILE.replace("$(ENVIRONMENT)", ".venv")
    return re.search(rf"^([\w-]+ )*{re.escape(name)}( [\w-]+)*:", rules, re.MULTILINE) is not None


@pytest.mark.parametrize(
    ("file", "expected"),
    [(WORKFLOW, {"test", "test-long"}), (HOOKS, {"lint", "types", "layers"}), (CONTAINER, {".venv/.ready-to-test"})],
)
def test_what_is_made_are_targets_that_there_are(file: str, expected: set[str]) -> None:
    text = re.sub(r"#.*", "", (ROOT / file).read_text(encoding="utf-8"))
    made = set(re.findall(r"\bmake ([\w./-]+)", text)) - {"python3-venv"}
    assert expected <= made and [name for name in made if not is_target(name)] == []


def test_the_workflow_runs_on_every_distribution_with_pinned_actions_and_no_rights() -> None:
    # "on" is a truth value in YAML 1.1, which PyYAML reads.
    workflow: Any = yaml.safe_load((ROOT / WORKFLOW).read_text(encoding="utf-8"))
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]["include"]
    assert [entry["distribution"] for entry in matrix] == ["jazzy", "kilted", "lyrical", "rolling"]
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step["uses"]) for step in steps if "uses" in step)
    assert workflow["permissions"] == {"contents": "read"}


def test_what_is_no_target_is_told_apart() -> None:
    assert is_target("test") and is_target("lint") and not is_target("tset")
