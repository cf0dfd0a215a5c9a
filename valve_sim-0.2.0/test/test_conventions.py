"""The files by which editors, commits and a public CI use the Makefile: well formed, and of targets that there are.

None of these programs runs here: what a container, pre-commit or a workflow does with the files is untested.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
DISTRIBUTIONS = ("jazzy", "kilted", "lyrical", "rolling")


def is_target(name: str) -> bool:
    """Whether the Makefile has a rule of this name."""
    return (
        re.search(rf"^{re.escape(name)}:|^([\w-]+ )*{re.escape(name)}( [\w-]+)*:", MAKEFILE, re.MULTILINE) is not None
    )


def made(command: str) -> list[str]:
    """What a command line makes."""
    return re.findall(r"\bmake ([\w./-]+)", command)


@pytest.fixture(scope="module")
def workflow() -> Any:
    # "on" is a truth value in YAML 1.1, which PyYAML reads.
    return yaml.safe_load((ROOT / ".github" / "workflows" / "ros.yml").read_text(encoding="utf-8"))


def test_the_workflow_runs_the_makefile_on_every_distribution(workflow: Any) -> None:
    job = workflow["jobs"]["test"]
    assert tuple(entry["distribution"] for entry in job["strategy"]["matrix"]["include"]) == DISTRIBUTIONS
    assert job["container"] == "ros:${{ matrix.distribution }}-ros-base"
    assert [entry["may_fail"] for entry in job["strategy"]["matrix"]["include"]] == [False, False, True, True]
    last = job["steps"][-1]["run"]
    assert last.startswith("source /opt/ros/${{ matrix.distribution }}/setup.bash && ") and made(last) == ["test"]


def test_each_step_uses_a_pinned_action_or_runs_targets_that_there_are(workflow: Any) -> None:
    targets = []
    for job in workflow["jobs"].values():
        assert re.fullmatch(r"ubuntu-\d\d\.\d\d", job["runs-on"])
        for step in job["steps"]:
            assert set(step) <= {"uses", "with", "name", "run", "if"} and ("uses" in step) != ("run" in step)
            assert re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step.get("uses", "a/b@v1"))
            targets += [target for target in made(step.get("run", "")) if not target.startswith("python")]
    assert {"test", "test-long"} <= set(targets) and all(map(is_target, targets)), targets
    assert workflow["permissions"] == {"contents": "read"}


def test_hooks_are_quick_checks_of_the_makefile() -> None:
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    assert local["repo"] == "local"
    entries = {hook["id"]: hook for hook in local["hooks"]}
    assert [made(hook["entry"]) for hook in entries.values()] == [["lint"], ["types"], ["layers"]]
    assert all(is_target(name) for name in entries)
    assert all(hook["language"] == "system" and hook["pass_filenames"] is False for hook in entries.values())


def test_the_container_is_made_by_the_makefile() -> None:
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert made(container["postCreateCommand"]) == [".venv/.ready-to-test"]
    assert "$(ENVIRONMENT)/.ready-to-test:" in MAKEFILE and "ENVIRONMENT := .venv" in MAKEFILE
    interpreter = container["customizations"]["vscode"]["settings"]["python.defaultInterpreterPath"]
    assert interpreter == "${containerWorkspaceFolder}/.venv/bin/python"


def test_what_is_no_target_is_told_apart() -> None:
    assert is_target("test") and is_target("lint") and not is_target("tset")
