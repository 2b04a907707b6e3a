"""Arrays in temporary files hold what arrays in memory hold, and leave nothing behind."""

import os
import tempfile

import numpy as np

from codec.gaussians.test_gaussians import some_splats
from splatwire.files import large
from splatwire.formats import read_splats, write_splats
from splatwire.levels import encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization, stream_to_bytes


def test_a_large_array_is_an_array(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(large, "LARGE_BYTES", 1)
    values = large.large_empty((5, 3), np.float32)
    values[:] = np.arange(15).reshape(5, 3)
    assert values.flags.writeable
    assert values.flags.c_contiguous
    assert type(values) is np.ndarray  # kernels are compiled for those
    assert values.sum() == 105
    assert large.large_empty((0, 3), np.float32).shape == (0, 3)
    assert os.listdir(tmp_path) == []


def test_without_room_on_disk_it_lies_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(large, "LARGE_BYTES", 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    assert large.large_empty((5,), np.int64).shape == (5,)


def test_scenes_in_files_and_in_memory_become_the_same_stream(tmp_path, monkeypatch):
    splats = some_splats(700)
    write_splats([splats], tmp_path / "a.ply")

    def encoded():
        return stream_to_bytes(encode_levels(SplatScene(read_splats(tmp_path / "a.ply")), Packetization(block_size=40)))

    in_memory = encoded()
    monkeypatch.setattr(large, "LARGE_BYTES", 1)
    assert encoded() == in_memory
