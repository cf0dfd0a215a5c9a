"""A file is written whole or stays as it was."""

from pathlib import Path

import pytest

from valve_sim.files.whole_files import atomic_write, refuse_unwritable, write_whole
from valve_sim.model.errors import ValveError
from valve_sim.recordings import TraceError


def test_a_file_replaces_the_old_one_and_its_folder_is_made(tmp_path: Path) -> None:
    path = tmp_path / "new" / "results.txt"
    write_whole(path, "µ")
    write_whole(path, "other")
    assert path.read_text(encoding="utf-8") == "other"
    assert list(path.parent.iterdir()) == [path]


def test_what_fails_half_way_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "results.txt"
    write_whole(path, "old")
    with pytest.raises(ZeroDivisionError), atomic_write(path) as partial:
        partial.write_text("half")
        1 / 0  # noqa: B018
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", [".", "..", "", "/", "a" * 300, "file/below", "folder"])
def test_a_place_that_takes_no_file_is_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TraceError, match=r"cannot be written \(.+\)"):
        write_whole(Path(name), "text", TraceError)
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder"}
    assert issubclass(TraceError, ValveError)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("file/below/it", "Not a directory"),
        ("folder", "Is a directory"),
        (f"{300 * 'a'}/it", "File name too long"),
    ],
)
def test_a_place_is_known_to_take_no_file_before_anything_is_made(name: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    refuse_unwritable(tmp_path / "new" / "results.txt", tmp_path / "file")
    with pytest.raises(ValveError, match=rf"{name}: cannot be written \({why}\); choose another place"):
        refuse_unwritable(tmp_path / "new" / "results.txt", tmp_path / name)
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder"}
