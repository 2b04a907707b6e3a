"""Arrays in temporary files have the same values as arrays in memory, and leave no file."""

import os
import tempfile

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import Packetization, stream_to_bytes
from splatwire.files import mmap_array as large
from splatwire.io.formats import read_splats, write_splats
from splatwire.lod import encode_levels
from splatwire.types import SplatScene


def test_large_array_behaves_like_an_array(tmp_path, monkeypatch):
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


def test_large_array_falls_back_to_memory_without_disk_space(tmp_path, monkeypatch):
    monkeypatch.setattr(large, "LARGE_BYTES", 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    assert large.large_empty((5,), np.int64).shape == (5,)


@pytest.mark.slow
def test_file_backed_and_in_memory_scenes_encode_to_the_same_stream(tmp_path, monkeypatch):
    splats = some_splats(700)
    write_splats([splats], tmp_path / "a.ply")

    def encoded():
        return stream_to_bytes(encode_levels(SplatScene(read_splats(tmp_path / "a.ply")), Packetization(block_size=40)))

    in_memory = encoded()
    monkeypatch.setattr(large, "LARGE_BYTES", 1)
    assert encoded() == in_memory
