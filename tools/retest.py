"""Runs pytest; what fails is run once more, by itself: `python tools/retest.py [what pytest is given]`.

For tests of live ROS nodes only. DDS may find a node late or lose a first message, and a busy machine holds up any
process: ROS 2's own CI runs `colcon test --retest-until-pass 2` for the same reason (create_jenkins_job.py in
https://github.com/ros2/ci). A test that passes only then is named, in the end too, until it has been mended.

Exit code: 0 if each test passed, at the second time at the latest; otherwise pytest's. Whatever ends the first run but
tests that fail (a crash, an error of collection, Ctrl-C) is a failure at once.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

UNSTEADY = "UNSTEADY_TESTS"
"""The environment variable with the file to which unsteady tests are added, for whoever says so in the end."""
TESTS_FAILED = 1
"""pytest's exit code when all has been run and some tests failed."""
RULE = "=" * 100


def run(arguments: Sequence[str], folder: Path) -> int:
    """Run pytest with a cache of its own, so that nothing counts but what failed here; its exit code."""
    options = ["-o", f"cache_dir={folder}", f"--junitxml={folder / 'results.xml'}"]
    return subprocess.run([sys.executable, "-m", "pytest", *arguments, *options], check=False).returncode


def failures(folder: Path) -> list[str]:
    """The tests that failed in the last run."""
    path = folder / "v" / "cache" / "lastfailed"
    return sorted(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else []


def passes(folder: Path) -> int:
    """How many tests the last run has passed: one that was skipped has not."""
    (suite,) = ElementTree.parse(folder / "results.xml").getroot().iter("testsuite")
    return int(suite.attrib["tests"]) - sum(int(suite.attrib[key]) for key in ("errors", "failures", "skipped"))


def say(unsteady: Sequence[str]) -> None:
    """Name what failed first and passed alone."""
    lines = [RULE, *(f"unsteady: {name} failed, and passed alone; mend it" for name in unsteady), RULE]
    print("\n".join(lines), flush=True)
    if path := os.environ.get(UNSTEADY):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with Path(path).open("a", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")


def main(arguments: Sequence[str]) -> int:
    """Both runs; the exit code."""
    with tempfile.TemporaryDirectory(prefix="retest-") as temporary:
        folder = Path(temporary)
        code = run(arguments, folder)
        failed = failures(folder)
        if code != TESTS_FAILED or not failed:
            return code
        print(f"{RULE}\n{len(failed)} failed of all; these are run once more, by themselves\n{RULE}", flush=True)
        code = run([*arguments, "--last-failed", "--last-failed-no-failures", "none"], folder)
        if code == 0 and passes(folder) < len(failed):
            print("not each of them has been run again and passed", flush=True)
            return TESTS_FAILED
        if code == 0:
            say(failed)
        return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
