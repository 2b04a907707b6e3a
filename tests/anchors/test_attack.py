"""Scene files and checkpoints with unexpected headers are read or refused in one sentence."""

import json
import random
import struct

import numpy as np
import pytest

from mutations import attack, mutated_bytes, mutated_json
from scenes import SMALL_CONFIG, VOXEL_SIZE, tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import load_scene_file, save_scene
from splatwire.data import Dataset, SparsePoints
from splatwire.errors import BitstreamError
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import RefineConfig, TrainConfig
from splatwire.neural.training.initial import initial_state
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.settings import GnnSettings
from splatwire.paper.gnn.weights import GnnWeights, load_weights, save_weights


def save_tiny_scene(path):
    save_scene(tiny_scene(num_anchors=20), path)


def save_tiny_checkpoint(path):
    config = TrainConfig(model=SMALL_CONFIG, voxel_size=VOXEL_SIZE, hidden=(4, 4, 4), refine=RefineConfig(steps=5))
    positions = tiny_scene(num_anchors=20).anchors.positions
    cameras = tiny_cameras(2)
    points = SparsePoints(positions, np.minimum(np.abs(positions), 1))
    save_checkpoint(initial_state(Dataset(cameras, (path, path), points), config), config, path)


def save_tiny_weights(path):
    settings = GnnSettings(neighbors=4, hidden=8, heads=2)
    network = InpaintingNetwork(InputSizes(SMALL_CONFIG.layout, SMALL_CONFIG.grid.context_dim), settings)
    save_weights(GnnWeights(network, "0" * 64, {"feature": 1.0}), path)


READERS = {
    "scene": (save_tiny_scene, load_scene_file),
    "checkpoint": (save_tiny_checkpoint, load_checkpoint),
    "weights": (save_tiny_weights, load_weights),
}


def with_header(data: bytes, text: str) -> bytes:
    """The safetensors file with another splatwire header."""
    (length,) = struct.unpack("<Q", data[:8])
    content = json.loads(data[8 : 8 + length])
    content["__metadata__"]["splatwire"] = text
    head = json.dumps(content).encode()
    head += b" " * (-len(head) % 8)
    return struct.pack("<Q", len(head)) + head + data[8 + length :]


def header_of(data: bytes):
    (length,) = struct.unpack("<Q", data[:8])
    return json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["splatwire"])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", READERS)
def test_hostile_scene_files_are_one_error(tmp_path, name, seed):
    save, load = READERS[name]
    path, rng = tmp_path / "a", random.Random(seed)
    save(path)
    load(path)
    data = path.read_bytes()
    header = header_of(data)
    attack(path, lambda: with_header(data, mutated_json(header, rng)), lambda: load(path), 120)
    attack(path, lambda: mutated_bytes(data, rng), lambda: load(path), 40)


@pytest.mark.slow
def test_weights_announcing_terabytes_allocate_nothing(tmp_path):
    save_tiny_weights(tmp_path / "a")
    data = (tmp_path / "a").read_bytes()
    header = header_of(data)
    for change in ({"context_dim": 10**12}, {"settings": {**header["settings"], "hidden": 4096, "layers": 4096}}):
        (tmp_path / "a").write_bytes(with_header(data, json.dumps({**header, **change})))
        with pytest.raises(BitstreamError):
            load_weights(tmp_path / "a")
