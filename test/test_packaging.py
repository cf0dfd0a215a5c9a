"""What is released is whole: manifests name what is used, and a source distribution holds what a checkout holds."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import valve_sim

ROOT = Path(__file__).parents[1]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
ROS = re.compile(r"rclpy|launch|launch_ros|ament_\w+|\w+_(msgs|srvs|interfaces)")
SHIPPED = ("bags", "benchmarks", "completions", "config", "docs", "launch", "resource", "test", "tools", "valve_sim")


def imported(*folders: str) -> Iterator[str]:
    """Every top-level package that is imported below the folders."""
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                yield node.module.partition(".")[0]


def named(*kinds: str) -> set[str]:
    return {node.text or "" for kind in kinds for node in MANIFEST.findall(kind)}


def test_the_manifest_names_every_ros_package_that_is_imported() -> None:
    used = {name for name in imported("valve_sim", "launch") if ROS.fullmatch(name)}
    assert "launch_ros" in used
    assert used <= named("exec_depend")
    tested = {name for name in imported("test", "benchmarks") if ROS.fullmatch(name)}
    assert tested <= named("exec_depend", "test_depend")


def test_all_that_states_a_version_states_the_same() -> None:
    version = MANIFEST.findtext("version")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    released = re.findall(r"^(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)$", changes, re.MULTILINE)
    assert valve_sim.__version__ == version
    assert citation["version"] == version
    assert citation["title"] == MANIFEST.findtext("name")
    assert citation["license"] == MANIFEST.findtext("license")
    assert {"cff-version", "message", "authors"} <= citation.keys()
    assert released[0] == (version, citation["date-released"])
    assert released == sorted(released, reverse=True)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tarfile.TarFile]:
    """A source distribution of this checkout."""
    pytest.importorskip("setuptools", reason="there is no setuptools here, which builds it")
    folder = tmp_path_factory.mktemp("sdist")
    command = [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", folder, "sdist", "--dist-dir", folder]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.tar.gz")
    with tarfile.open(path) as opened:
        yield opened


def test_a_source_distribution_holds_all_files_of_a_checkout(archive: tarfile.TarFile) -> None:
    held = {member.name.partition("/")[2] for member in archive.getmembers()}
    files = {path.relative_to(ROOT) for name in SHIPPED for path in (ROOT / name).rglob("*") if path.is_file()}
    generated = Path("docs/reference/api")
    wanted = {
        path.as_posix() for path in files if "__pycache__" not in path.parts and not path.is_relative_to(generated)
    }
    assert wanted - held == set()
    assert {"setup.py", "pyproject.toml", "package.xml", "Makefile", "LICENSE", "CHANGELOG.rst"} <= held
