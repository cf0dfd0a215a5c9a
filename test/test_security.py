"""Nothing that is read is ever run: safe loaders, escaped names, a compile cache of our own; ruff looks for eval."""

from __future__ import annotations

import json
import os
import stat
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from click.testing import CliRunner
from identification.recordings import one_opening

from valve_sim.cli import main
from valve_sim.files import yaml_files
from valve_sim.files.parameter_files import load_valve
from valve_sim.model import ValveError
from valve_sim.model.core import machine
from valve_sim.traces import list_valves, write_bag
from valve_sim.traces.synthetic import read_profile

SCRIPT = "<script>alert(1)</script>"


def test_the_one_loader_of_our_own_is_a_safe_one() -> None:
    assert issubclass(yaml_files._Loader, yaml.SafeLoader)


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


class Page(HTMLParser):
    """The elements of a page, the attributes that run scripts, and what the scripts hold."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[str] = []
        self.handlers: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.elements and self.elements[-1] == "script":
            self.scripts[-1] += data
        else:
            self.text += data


NAMES = {
    "a script": SCRIPT,
    "an attribute": "\" onmouseover='alert(1)' x=\"",
    "the end of JSON": "</script><script>alert(1);",
    "a comment": "<!--<script>",
    "mathematics": r"$\frac{1}{$",
    "a template": "{{ 7 * 7 }}{% raw %}",
}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """The report of a recording with a harmless name."""
    return diagnosed(tmp_path_factory.mktemp("clean"), "valve")


def diagnosed(folder: Path, name: str) -> Page:
    """The report of a recording whose file and valve have this name."""
    bag = folder / f"{name}.mcap"
    bag.parent.mkdir(parents=True, exist_ok=True)
    write_bag(bag, one_opening(), valve=f"/{name}")
    assert list_valves(bag) == (f"/{name}",)
    results = folder / "results"
    ran = CliRunner().invoke(main, ["diagnose", str(bag), "--budget", "1", "--output", str(results)])
    assert ran.exit_code == 0, ran.output
    json.loads((results / "report.json").read_text())
    load_valve(results / "corrected.yaml")
    return Page((results / "report.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_a_name_in_a_bag_is_text_on_the_page(clean: Page, tmp_path: Path, name: str) -> None:
    page = diagnosed(tmp_path, name)
    assert page.elements == clean.elements
    assert page.handlers == []
    assert json.loads(page.scripts[0]).keys() == {"strokes", "maps"}
    assert page.scripts[1:] == clean.scripts[1:]
    assert name in page.text


@pytest.mark.parametrize("name", [*NAMES.values(), "\x1b]0;owned\x07", "a\x01b"], ids=[*NAMES, "escapes", "control"])
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


@pytest.mark.parametrize(("mode", "is_used"), [(0o700, True), (0o777, False), (0o770, False), (0o702, False)])
def test_one_that_others_can_write_to_is_not_used(cache: Path, mode: int, is_used: bool) -> None:
    folder = machine.folder_in_use()
    assert folder is not None
    folder.chmod(mode)
    assert (machine.folder_in_use() == folder) is is_used


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_one_that_somebody_else_owns_is_not_used(cache: Path) -> None:
    folder = machine.folder_in_use()
    assert folder is not None
    os.chown(folder, 12345, -1)
    assert machine.folder_in_use() is None


@pytest.mark.parametrize(
    ("mode", "is_link", "is_used"),
    [(0o777, False, False), (0o1777, False, True), (0o775, False, True), (0o777, True, False)],
)
def test_one_that_others_can_exchange_is_not_used(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, is_link: bool, is_used: bool
) -> None:
    place = tmp_path / "open" if is_link else cache
    place.mkdir()
    place.chmod(mode)
    if is_link:
        cache.symlink_to(place)
    else:
        monkeypatch.setenv("VALVE_SIM_CACHE", str(cache / "own"))
    assert (machine.folder_in_use() is not None) is is_used


@pytest.fixture
def homeless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without a home, as in a container: temporary files are all that there is. Where they are."""

    for name in ("VALVE_SIM_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


def test_without_a_home_code_is_kept_among_temporary_files_or_where_it_is_told_to_be(
    homeless: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = machine.folder_in_use()
    assert folder is not None and folder.parent == homeless
    monkeypatch.setenv("VALVE_SIM_CACHE", str(tmp_path / "chosen"))
    folder = machine.folder_in_use()
    assert folder is not None and folder == tmp_path / "chosen"


@pytest.mark.parametrize("home", ["/dev/null", "here", ""])
def test_a_home_that_cannot_be_written_gives_way_to_temporary_files(
    homeless: Path, home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv("HOME", home)
    folder = machine.folder_in_use()
    assert folder is not None and folder.parent == homeless
    assert not list(Path.cwd().iterdir())


@pytest.mark.parametrize("name", ["VALVE_SIM_CACHE", "XDG_CACHE_HOME"])
@pytest.mark.parametrize("relative", ["cache", ".", "../cache"])
def test_a_relative_path_is_never_written_to(
    homeless: Path, name: str, relative: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setenv(name, relative)
    if name == "VALVE_SIM_CACHE":
        assert machine.folder_in_use() is None
    else:
        folder = machine.folder_in_use()
        assert folder is not None and folder.parent == homeless
    assert not list(Path.cwd().iterdir())
    assert not (tmp_path / "cache").exists()
