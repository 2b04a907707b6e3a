"""The store: whole files or none, one coordinator, a full disk."""

import errno
import os

import pytest

from splatwire.errors import SplatwireError
from splatwire.evaluate.study.records import TIMINGS, records_from_bytes, records_to_bytes
from splatwire.evaluate.study.store import Store


def test_a_full_disk_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SplatwireError, match=r"disk is full.*finished work is kept"):
        Store(tmp_path).put_unit("a", b"records")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_unfinished_files_are_no_records_and_go_away(tmp_path):
    store = Store(tmp_path)
    store.put_unit("whole", b"records")
    half = tmp_path / "units" / ".half.parquet.123.abc.part"
    half.write_bytes(b"rec")
    assert store.missing(["whole", "half", "half"]) == ["half"]
    with store.locked():
        assert not half.exists()
    assert store.unit_path("whole").read_bytes() == b"records"


def test_one_run_at_a_time(tmp_path):
    with Store(tmp_path).locked(), pytest.raises(SplatwireError, match="another run"), Store(tmp_path).locked():
        pass
    with Store(tmp_path).locked():
        pass


def test_records_survive_parquet():
    record = {
        "unit": "u",
        "scene": "s",
        "view": "v",
        "view_index": 1,
        "seed": None,
        "psnr": float("inf"),
        "lpips": None,
    }
    data = records_to_bytes([record])
    (read,) = records_from_bytes(data, "x")
    assert {key: read[key] for key in record} == record
    assert set(TIMINGS) < set(read)
    assert data == records_to_bytes([record])
    with pytest.raises(SplatwireError, match="x is not a file of records"):
        records_from_bytes(data[:-9], "x")
