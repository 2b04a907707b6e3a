"""The store: complete files or none, one coordinator, a full disk."""

import contextlib
import errno
import os
import signal
import sys

import numpy as np
import pytest

from splatwire.errors import BackendUnavailableError, SplatwireError
from splatwire.evaluation.pixels import png_bytes
from splatwire.evaluation.study.definition import canonical
from splatwire.evaluation.study.inputs import stored_stream
from splatwire.evaluation.study.local_engine import _Worker
from splatwire.evaluation.study.prepared_stream import PreparedStream
from splatwire.evaluation.study.records import Record, records_from_bytes, records_to_bytes
from splatwire.evaluation.study.references import digest_of_files
from splatwire.evaluation.study.store import MemoryStore, Store

RECORD = Record(
    unit="a", scene="s", stream="paper", mask="", loss="none", loss_unit=None, send_order=None, conceal="drop",
    options="{}", erode=None, view="v", renderer="cpu", code="1", seed=None, view_index=0, num_anchors=9,
    num_lost_anchors=0, num_packets=2, num_lost_packets=0, num_datagrams=None, num_lost_datagrams=None,
    num_bytes_received=77, psnr=float("inf"), ssim=1.0, lpips=None, seconds_decode=0.5, seconds_conceal=0.25,
    seconds_render=0.125, seconds_score=0.0,
)  # fmt: skip


def test_full_disk_leaves_no_partial_records(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SplatwireError, match=r"disk is full.*finished work is kept"):
        Store(tmp_path).put_records("a", [RECORD])
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_unfinished_files_are_ignored_and_removed(tmp_path):
    store = Store(tmp_path)
    store.put_records("a", [RECORD])
    half = tmp_path / "units" / ".splatwire-0123456789ab.part" / "new" / "half.parquet"
    half.parent.mkdir(parents=True)
    half.parent.parent.chmod(0o700)
    half.write_bytes(b"rec")
    assert [store.has(key) for key in ("a", "half")] == [True, False]
    with store.locked():
        assert [path.name for path in (tmp_path / "units").iterdir()] == ["a.parquet"]
    assert store.records("a") == [RECORD]


def test_unfinished_files_of_workers_that_a_signal_ended_are_removed(tmp_path):
    store = Store(tmp_path)
    store.write("inputs/key/stream", b"")
    with contextlib.suppress(KeyboardInterrupt), store.locked():
        space = tmp_path / "inputs" / "key" / ".splatwire-0123456789ab.part"
        space.mkdir(mode=0o700)
        raise KeyboardInterrupt
    assert [path.name for path in (tmp_path / "inputs" / "key").iterdir()] == ["stream"]


@pytest.mark.slow
def test_ctrl_c_does_not_reach_a_worker(tmp_path):
    """A terminal sends it to all processes, and a worker that is starting would print a traceback."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    worker = _Worker.start(str(tmp_path))
    try:
        os.kill(worker.process.pid, signal.SIGINT)
        worker.pipe.send("no task")
        assert worker.pipe.recv().startswith("AttributeError")
    finally:
        worker.stop()
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.parametrize(
    "damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: data[:40] + bytes(9) + data[49:]]
)
def test_damaged_pictures_are_named_with_the_way_out(damage, tmp_path):
    store = Store(tmp_path)
    pixels = np.arange(300, dtype=np.uint8).reshape(10, 10, 3)
    store.write("pictures/a.png", damage(png_bytes(pixels)))
    with pytest.raises(SplatwireError, match=r"pictures/a\.png is damaged: .*; remove it and start again$"):
        store.picture("pictures/a.png")
    store.write("pictures/a.png", png_bytes(pixels))
    assert (store.picture("pictures/a.png") == pixels).all()


@pytest.mark.parametrize("damage", [lambda path: path.write_bytes(b"packe"), lambda path: path.unlink()])
def test_scores_of_a_damaged_stream_are_not_stored(damage, tmp_path):
    """The readers of streams use the intact packets of a damaged file."""
    store, about = Store(tmp_path), tmp_path / "inputs" / "a.json"
    assert stored_stream(store, "inputs/a.swz", about) is None
    path = store.write("inputs/a.swz", b"packets")
    known = PreparedStream("inputs/a.swz", digest_of_files(path), {}, 1, 2)
    store.write("inputs/a.json", canonical(vars(known)).encode())
    assert stored_stream(store, "inputs/a.swz", about) == known
    damage(path)
    with pytest.raises(SplatwireError, match=r"a\.swz is missing or damaged: remove its folder and start again"):
        stored_stream(store, "inputs/a.swz", about)
    about.write_text('{"digest": "of another release"}')
    with pytest.raises(SplatwireError, match="remove its folder"):
        stored_stream(store, "inputs/a.swz", about)


def test_concurrent_runs_on_one_store_are_refused(tmp_path):
    with Store(tmp_path).locked(), pytest.raises(SplatwireError, match="another run"), Store(tmp_path).locked():
        pass
    with Store(tmp_path).locked():
        pass


def test_links_in_a_store_are_not_followed(tmp_path):
    left = tmp_path / "elsewhere" / ".splatwire-0123456789ab.part"
    left.mkdir(parents=True)
    left.chmod(0o700)
    root = tmp_path / "store"
    root.mkdir()
    (root / "units").symlink_to(tmp_path / "elsewhere")
    with Store(root).locked():
        assert left.is_dir()
    (root / "lock").unlink()
    (root / "lock").symlink_to(tmp_path / "new")
    with pytest.raises(OSError, match="symbolic links"), Store(root).locked():
        pass
    assert not (tmp_path / "new").exists()


def test_records_survive_parquet(tmp_path):
    data = records_to_bytes([RECORD])
    assert records_from_bytes(data, "x") == [RECORD]
    assert data == records_to_bytes([RECORD])
    with pytest.raises(SplatwireError, match="x is not a file of records"):
        records_from_bytes(data[:-9], "x")
    Store(tmp_path).put_records("b", [RECORD])
    with pytest.raises(SplatwireError, match="does not hold the records of its unit"):
        Store(tmp_path).records("b")


def test_unwritable_store_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(BackendUnavailableError, match=r"splatwire\[tables\]"), Store(tmp_path / "s").locked():
        raise AssertionError("the work began")
    assert not (tmp_path / "s").exists()
    with MemoryStore(tmp_path / "m").locked():
        pass
