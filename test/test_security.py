"""Nothing that is read is ever run: safe loaders, escaped names, a compile cache of our own; ruff looks for eval."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner
from identification.recordings import one_opening

from valve_sim.cli import main
from valve_sim.files.parameter_files import load_valve
from valve_sim.model import ValveError
from valve_sim.model.core import machine
from valve_sim.recordings import write_bag
from valve_sim.recordings.synthetic import read_profile


@pytest.mark.parametrize("read", [load_valve, read_profile])
def test_yaml_that_would_call_something_is_refused(tmp_path: Path, read) -> None:
    mark = tmp_path / "was_run"
    path = tmp_path / "file.yaml"
    path.write_text(f"valve: !!python/object/apply:os.mkdir ['{mark}']\n")
    with pytest.raises(ValveError) as refusal:
        read(path)
    assert "\n" not in str(refusal.value)
    assert not mark.exists()


# --- names from bags ---


HOSTILE = " ".join(
    [
        "<script>alert(1)</script>",
        "\" onmouseover='alert(1)' x=\"",
        "</script><script>alert(1);",
        "<!--<script>",
        r"$\frac{1}{$",
        "{{ 7 * 7 }}{% raw %}",
    ]
)


@pytest.mark.parametrize("name", [HOSTILE, "\x1b]0;owned\x07 a\x01b"])
def test_a_name_in_a_bag_is_text_in_junit_and_on_the_terminal(tmp_path: Path, name: str) -> None:
    bag, junit = tmp_path / "x.mcap", tmp_path / "replay.xml"
    write_bag(bag, one_opening(), valve=f"/{name}")
    shipped = Path(__file__).parents[1] / "config" / "valve.yaml"
    ran = CliRunner().invoke(main, ["validate", str(bag), "--params", str(shipped), "--junit", str(junit)], color=True)
    assert ran.exit_code in (0, 1), ran.output
    assert {element.tag for element in ElementTree.parse(junit).iter()} <= {
        "testsuites", "testsuite", "testcase", "failure", "properties", "property", "system-out",
    }  # fmt: skip
    for arguments in (["info", str(bag)], ["info", str(bag), "--valve", "/other"]):
        ran = CliRunner().invoke(main, arguments, color=True)
        assert not set(ran.output) & {"\x1b", "\x07", "\x01"}


# --- the compile cache: loading it runs code ---


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where code would be kept."""
    place = tmp_path / "cache"
    monkeypatch.setenv("VALVE_SIM_CACHE", str(place))
    return place


def test_a_new_cache_is_closed_to_others_whatever_the_umask(cache: Path) -> None:
    before = os.umask(0)
    try:
        folder = machine.folder_in_use()
    finally:
        os.umask(before)
    assert folder is not None
    assert folder == cache
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.parametrize(
    ("mode", "above", "is_link", "is_used"),
    [
        (0o700, 0o700, False, True),
        (0o770, 0o700, False, False),
        (0o702, 0o700, False, False),
        (0o700, 0o777, False, False),  # others can exchange it
        (0o700, 0o1777, False, True),
        (0o700, 0o700, True, False),
    ],
)
def test_one_that_others_can_write_to_or_exchange_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, above: int, is_link: bool, is_used: bool
) -> None:
    place = tmp_path / "above" / "cache"
    (tmp_path / "real").mkdir(mode=0o777)
    place.parent.mkdir()
    if is_link:
        (tmp_path / "real").chmod(0o777)
        place.symlink_to(tmp_path / "real")
    else:
        place.mkdir()
        place.chmod(mode)
    place.parent.chmod(above)
    monkeypatch.setenv("VALVE_SIM_CACHE", str(place))
    assert (machine.folder_in_use() == place) is is_used


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_one_that_somebody_else_owns_is_not_used(cache: Path) -> None:
    folder = machine.folder_in_use()
    assert folder is not None
    os.chown(folder, 12345, -1)
    assert machine.folder_in_use() is None


@pytest.fixture
def homeless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without a home, as in a container: temporary files are all that there is. Where they are."""

    for name in ("VALVE_SIM_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


@pytest.mark.parametrize(
    ("name", "value", "falls_back"),
    [
        ("HOME", "/dev/null", True),
        ("HOME", "here", True),
        ("HOME", "", True),
        ("XDG_CACHE_HOME", "../cache", True),
        ("VALVE_SIM_CACHE", "../cache", False),
    ],
)
def test_a_home_that_cannot_be_written_or_a_relative_path_gives_way_to_temporary_files(
    homeless: Path, name: str, value: str, falls_back: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv(name, value)
    folder = machine.folder_in_use()
    assert folder is not None and folder.parent == homeless if falls_back else folder is None
    assert not list(Path.cwd().iterdir())
    assert not (tmp_path / "cache").exists()
