import os
import shutil

import numpy as np
import pytest

from splatwire.bitstream import PacketId, read_stream, write_stream
from splatwire.errors import BitstreamError, InvalidValueError, MissingSideInfoError


@pytest.fixture
def folder(stream, tmp_path):
    write_stream(stream, tmp_path / "scene")
    return tmp_path / "scene"


def counts(report):
    return report.num_missing, report.num_corrupt, report.num_foreign, report.num_duplicate


def test_directory_uses_the_papers_file_names(folder):
    assert {"manifest.json", "side_info.bin", "pak_lane0_s0.pak", "pak_lane3_s6.pak"} < set(os.listdir(folder))
    assert len(os.listdir(folder)) == 2 + 28


def test_deleting_a_file_loses_a_packet(folder, stream):
    (folder / "pak_lane1_s2.pak").unlink()
    found, report = read_stream(folder)
    assert [p for p in stream.packets if p.id.filename != "pak_lane1_s2.pak"] == list(found.packets)
    assert counts(report) == (1, 0, 0, 0)


def test_damaged_misnamed_and_foreign_files_are_counted(folder, make_test_stream, tmp_path):
    write_stream(make_test_stream(seed=3), tmp_path / "other")
    damaged = bytearray((folder / "pak_lane0_s0.pak").read_bytes())
    damaged[-1] ^= 1
    (folder / "pak_lane0_s0.pak").write_bytes(damaged)
    (folder / "pak_lane1_s0.pak").write_bytes((folder / "pak_lane1_s0.pak").read_bytes()[:10])
    (folder / "pak_lane2_s0.pak").write_bytes(b"")
    shutil.copy(tmp_path / "other" / "pak_lane3_s0.pak", folder / "pak_lane3_s0.pak")
    shutil.copy(folder / "pak_lane0_s1.pak", folder / "pak_lane1_s1.pak")
    shutil.copy(folder / "pak_lane0_s1.pak", folder / "copy.pak")
    (folder / "pak_lane0_s5000.pak").mkdir()
    found, report = read_stream(folder)
    assert counts(report) == (5, 6, 1, 0)
    assert len(found.packets) == 23
    assert len(report.problems) == 7
    assert all(".pak" in problem for problem in report.problems)


def test_named_pipe_does_not_block(folder):
    (folder / "pak_lane0_s0.pak").unlink()
    os.mkfifo(folder / "pak_lane0_s0.pak")
    assert counts(read_stream(folder)[1]) == (1, 1, 0, 0)


@pytest.mark.parametrize("name", ["manifest.json", "side_info.bin"])
def test_missing_or_damaged_side_information_names_the_file(folder, name):
    path = folder / name
    data = path.read_bytes()
    for damaged in (data[:-1], data[:50] + b"?" + data[51:], data + b"x" * 100_000, b""):
        path.write_bytes(damaged)
        with pytest.raises(BitstreamError, match=name):
            read_stream(folder)
    path.unlink()
    with pytest.raises(MissingSideInfoError, match=f"{name} is missing"):
        read_stream(folder)


def test_link_cycle_is_a_loss_or_one_error(folder):
    (folder / "pak_lane0_s0.pak").unlink()
    (folder / "pak_lane0_s0.pak").symlink_to("pak_lane0_s0.pak")
    assert counts(read_stream(folder)[1]) == (1, 1, 0, 0)
    (folder / "manifest.json").unlink()
    (folder / "manifest.json").symlink_to("manifest.json")
    with pytest.raises(BitstreamError, match=r"manifest\.json cannot be read"):
        read_stream(folder)


def test_wrong_paths_are_refused(tmp_path):
    with pytest.raises(BitstreamError, match="not a splatwire stream"):
        read_stream(tmp_path)
    with pytest.raises(BitstreamError, match="no such file"):
        read_stream(tmp_path / "nowhere")
    (tmp_path / "x.swz").write_bytes(b"ply\nformat binary")
    with pytest.raises(BitstreamError, match=r"x\.swz: not a splatwire stream"):
        read_stream(tmp_path / "x.swz")
    with pytest.raises(BitstreamError, match="a device, pipe or socket"):
        read_stream("/dev/null")


@pytest.mark.parametrize("name", ["scene", "scene.swz"])
def test_rewriting_removes_stale_packets(stream, tmp_path, name):
    few = stream.with_packets(stream.packets[:3])
    for version in (stream, few):
        write_stream(version, tmp_path / name)
        assert read_stream(tmp_path / name)[0] == version
        assert os.listdir(tmp_path) == [name]


def test_writing_fills_an_empty_folder_and_makes_no_folder_above(stream, tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    write_stream(stream, tmp_path / "a" / "b")
    assert read_stream(tmp_path / "a" / "b")[0] == stream
    for name in ("c/d.swz", "c/d"):
        with pytest.raises(InvalidValueError, match=r"no such folder, so d.* make it first"):
            write_stream(stream, str(tmp_path / name))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_targets_that_are_no_stream_are_not_overwritten(stream, tmp_path):
    photos, file = tmp_path / "photos", tmp_path / "notes.swz"
    photos.mkdir()
    (photos / "holiday.jpg").write_bytes(b"jpeg")
    file.write_bytes(b"notes")
    for target in (photos, file):
        with pytest.raises(BitstreamError, match="left alone"):
            write_stream(stream, target)
    (tmp_path / "dir.swz").mkdir()
    (tmp_path / "plain").write_bytes(b"")
    for target in (tmp_path / "dir.swz", tmp_path / "plain"):
        with pytest.raises(BitstreamError, match="left alone"):
            write_stream(stream, target)
    assert (photos / "holiday.jpg").read_bytes() == b"jpeg"
    assert file.read_bytes() == b"notes"


def test_stream_folder_with_other_files_is_not_overwritten(stream, folder):
    (folder / "notes.txt").write_text("mine")
    assert read_stream(folder)[0] == stream
    with pytest.raises(BitstreamError, match=r"notes\.txt"):
        write_stream(stream, folder)


def test_a_failed_write_keeps_the_old_stream(stream, folder, monkeypatch):
    monkeypatch.setattr(PacketId, "filename", property(lambda _: 1 / 0))
    with pytest.raises(ZeroDivisionError):
        write_stream(stream.with_packets(stream.packets[:2]), folder)
    monkeypatch.undo()
    assert read_stream(folder)[0] == stream
    assert os.listdir(folder.parent) == ["scene"]


def test_mutated_directories_are_read_or_refused(stream, tmp_path):
    """60 directories with damaged, truncated, swapped and removed files."""
    rng, known = np.random.default_rng(3), set(stream.packets)
    for trial in range(60):
        folder = tmp_path / str(trial)
        write_stream(stream, folder)
        names = sorted(name for name in os.listdir(folder) if name.endswith(".pak"))
        touched = set()
        for name in rng.choice(names, size=5, replace=False):
            data = bytearray((folder / name).read_bytes())
            match int(rng.integers(4)):
                case 0:
                    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
                case 1:
                    del data[int(rng.integers(len(data))) :]
                case 2:
                    data = bytearray(rng.bytes(50))
                case 3:
                    data = bytearray(b"".join([data, data]))
            (folder / name).write_bytes(data)
            touched.add(str(name))
        found, report = read_stream(folder)
        assert counts(report) == (5, 5, 0, 0)
        assert known - set(found.packets) == {p for p in known if p.id.filename in touched}
