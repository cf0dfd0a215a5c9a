"""What is a bag, wherever it lies, and what of its name reaches a row."""

from __future__ import annotations

from pathlib import Path

import fsspec
import pytest

from valve_sim.fleet.sources import Bag, BagFile, SourceError, at_hand, bags_among, content_hash, find_bags


def touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(path.name.encode())


@pytest.mark.parametrize(
    ("files", "bags"),
    [
        (["a/metadata.yaml", "a/a_0.mcap", "a/a_1.mcap"], [("a", True)]),
        (["a/metadata.yaml"], [("a", True)]),
        (["a/a_0.mcap", "a/a_1.mcap"], [("a", True)]),
        (["a/day_1.mcap", "a/day_2.mcap"], [("a/day_1.mcap", False), ("a/day_2.mcap", False)]),
        (["a/x.db3", "a/b/metadata.yaml", "a/b/b.mcap.zstd"], [("a/x.db3", False), ("a/b", True)]),
        (["a/notes.txt", "a/.half.mcap", "a/fleet.parquet"], []),
        (["a/old.bag"], [("a/old.bag", False)]),
    ],
)
def test_what_is_a_bag(files: list[str], bags: list[tuple[str, bool]]) -> None:
    assert [(path, is_folder) for path, _, is_folder in bags_among(files)] == bags


def test_parts_of_a_bag_are_in_the_order_in_which_they_were_recorded() -> None:
    ((_, files, _),) = bags_among([f"a/a_{number}.mcap" for number in (10, 2, 1)])
    assert files == ["a/a_1.mcap", "a/a_2.mcap", "a/a_10.mcap"]


def test_bags_of_folders_files_and_globs_are_found_once(tmp_path: Path) -> None:
    touch(tmp_path / "one" / "metadata.yaml", tmp_path / "deep" / "er" / "two.mcap", tmp_path / "[odd]" / "three.mcap")
    sources = [str(tmp_path), str(tmp_path / "*"), str(tmp_path / "deep/er/two.mcap"), str(tmp_path / "[odd]")]
    assert [bag.source for bag in find_bags(sources)] == [
        str(tmp_path / "[odd]" / "three.mcap"), str(tmp_path / "deep" / "er" / "two.mcap"), str(tmp_path / "one"),
    ]  # fmt: skip


def test_a_source_without_a_bag_is_refused_in_one_line(tmp_path: Path) -> None:
    for source, words in ((tmp_path / "none", "does not exist"), (tmp_path, "no bag in it")):
        with pytest.raises(SourceError, match=words) as refused:
            find_bags([str(source)])
        assert str(refused.value).startswith(f"{source}: ")
        assert "\n" not in str(refused.value)


def test_a_bag_that_is_written_again_has_another_stamp_and_content(tmp_path: Path) -> None:
    touch(tmp_path / "a.mcap")
    (before,) = find_bags([str(tmp_path)])
    hash_before = content_hash(before, tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_bytes(b"longer than it was")
    (after,) = find_bags([str(tmp_path)])
    assert before.stamp != after.stamp
    assert hash_before != content_hash(after, tmp_path / "a.mcap")


def test_a_remote_bag_is_fetched_whole_and_has_the_content_of_a_local_one(tmp_path: Path) -> None:
    touch(tmp_path / "bag" / "metadata.yaml", tmp_path / "bag" / "bag_0.mcap")
    memory = fsspec.filesystem("memory")
    memory.put(str(tmp_path / "bag"), "/fleet-test/bag", recursive=True)
    (local,) = find_bags([str(tmp_path)])
    (remote,) = find_bags(["memory://fleet-test"])
    assert remote.source == "memory://fleet-test/bag"
    with at_hand(remote) as place:
        assert place.name == "bag"
        assert sorted(path.name for path in place.iterdir()) == ["bag_0.mcap", "metadata.yaml"]
        assert content_hash(remote, place) == content_hash(local, tmp_path / "bag")
    assert not place.exists()
    memory.rm("/fleet-test", recursive=True)


@pytest.mark.parametrize("name", ["..", ".", "a\\b", "a\0b"])
def test_a_name_in_an_object_storage_cannot_lead_out_of_the_workers_folder(name: str) -> None:
    bag = Bag("memory://x", (BagFile(f"/x/{name}", 1, ""),), True)
    with pytest.raises(SourceError, match="cannot be the name of a file"), at_hand(bag):
        pass


@pytest.mark.parametrize("url", ["ftp://user:secret@host/bag", "https://host/bag.mcap?X-Amz-Signature=secret"])
def test_a_url_that_holds_credentials_is_refused_without_them(url: str) -> None:
    with pytest.raises(SourceError, match="holds credentials") as refused:
        find_bags([url])
    assert "secret" not in str(refused.value)
