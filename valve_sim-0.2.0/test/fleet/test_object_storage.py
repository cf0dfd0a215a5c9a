"""A fleet from S3: the same rows as from files, and no credential in anything that is written or said."""

from __future__ import annotations

import logging
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import s3fs

from valve_sim.fleet.run import examine_fleet
from valve_sim.fleet.sources import SourceError, find_bags

from .bags import assert_rows_agree, make_bag
from .object_storage import object_storage

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


def test_the_same_rows_from_s3_as_from_files_and_no_credential_anywhere(
    bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with object_storage(tmp_path / "bucket", KEY) as address:
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
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


def test_a_real_server_of_s3_gives_the_same_rows(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moto speaks as S3 does: listings in pages, signatures, checksums; ours above is as little as will do."""
    server = pytest.importorskip("moto.server", reason="needs moto: pip install moto flask flask-cors")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    moto = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    moto.start()
    try:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{moto.get_host_and_port()[1]}")
        storage = s3fs.S3FileSystem()
        storage.mkdir("plant")
        storage.put(str(tmp_path / "bucket" / "2026"), "plant/2026", recursive=True)
        examine_fleet([bucket], tmp_path / "there")
    finally:
        moto.stop()
        s3fs.S3FileSystem.clear_instance_cache()
    examine_fleet([str(tmp_path / "bucket" / "2026")], tmp_path / "here")
    assert pq.read_metadata(tmp_path / "there" / "fleet.parquet").num_rows == 3
    assert_rows_agree(tmp_path / "here", tmp_path / "there", {"source", "stamp", "seconds", "error", "key"})


def test_a_refused_key_is_one_line_without_it(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with object_storage(tmp_path / "bucket", "AKIAANOTHERKEYXX1234") as address:
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        with pytest.raises(SourceError, match=r"s3://plant/2026: cannot be listed") as refused:
            find_bags([bucket])
    assert KEY not in str(refused.value)
    assert SECRET not in str(refused.value)
    assert "\n" not in str(refused.value)
