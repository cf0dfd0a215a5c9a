"""A fleet from S3: the same rows as from files, and no credential in anything that is written or said."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pyarrow.parquet as pq
import pytest
import s3fs

from valve_sim.fleet.run import examine_fleet
from valve_sim.fleet.sources import SourceError, find_bags

from .bags import assert_rows_agree, make_bag

pytestmark = pytest.mark.long

KEY, SECRET = "AKIAIOSFODNN7EXAMPLE", "wJalrXUtnFEMI/K7MDENG/bPxRfiCYEXAMPLEKEY"


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The URL of a bucket with a bag, an empty one, and one of which only the metadata have arrived."""
    make_bag(tmp_path / "bucket" / "2026" / "day_1", 1.0)
    (tmp_path / "bucket" / "2026" / "empty.mcap").write_bytes(b"")
    (tmp_path / "bucket" / "2026" / "half").mkdir()
    (tmp_path / "bucket" / "2026" / "half" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    s3fs.S3FileSystem.clear_instance_cache()
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", KEY)
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    return "s3://plant/2026"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Moto, which speaks as S3 does: listings in pages, signatures, checksums."""
    moto = pytest.importorskip("moto.server", reason="needs moto: pip install moto flask flask-cors")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    running = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    running.start()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{running.get_host_and_port()[1]}")
    yield pytest.importorskip("moto.settings")
    running.stop()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.usefixtures("server")
def test_the_same_rows_from_s3_as_from_files_and_no_credential_anywhere(bucket: str, tmp_path: Path) -> None:
    storage = s3fs.S3FileSystem()
    storage.mkdir("plant")
    storage.put(str(tmp_path / "bucket" / "2026"), "plant/2026", recursive=True)
    examine_fleet([bucket], tmp_path / "there")
    assert examine_fleet([bucket], tmp_path / "there").done == 0
    examine_fleet([str(tmp_path / "bucket" / "2026")], tmp_path / "here")
    here, there = (pq.read_table(tmp_path / name / "fleet.parquet").to_pylist() for name in ("here", "there"))
    assert sorted(row["source"] for row in there) == [
        f"s3://plant/2026/{name}" for name in ("day_1", "empty.mcap", "half")
    ]
    assert_rows_agree(tmp_path / "here", tmp_path / "there", {"source", "stamp", "seconds", "error", "key"})
    for one, other in zip(here, there, strict=True):
        assert one["error"].replace(str(tmp_path / "bucket"), "s3://plant") == other["error"]
    for path in tmp_path.rglob("there/**/*"):
        if path.is_file():
            assert KEY.encode() not in path.read_bytes()
            assert SECRET.encode() not in path.read_bytes()


def test_a_refused_key_is_one_line_without_it(bucket: str, server: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "INITIAL_NO_AUTH_ACTION_COUNT", 0.0)  # from the first request on keys are checked
    with pytest.raises(SourceError, match=r"s3://plant/2026: cannot be listed \(The AWS Access Key Id") as refused:
        find_bags([bucket])
    assert KEY not in str(refused.value)
    assert SECRET not in str(refused.value)
    assert "\n" not in str(refused.value)
