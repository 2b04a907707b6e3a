"""Models of other software with unexpected bytes and numbers are read, or rejected with one clear error."""

import json
import random

import numpy as np
import pytest

from mutations import HOSTILE, attack, mutated_bytes
from splatwire.errors import DatasetError
from splatwire.neural.importers.hacpp import import_hacpp


@pytest.mark.slow
@pytest.mark.parametrize("name", ["point_cloud.ply", "checkpoint.pth", "x_bound_min.pkl", "xyz_gpcc.npz"])
def test_hostile_model_folder_files_are_one_error(model, name):
    model.write()
    path = next(model.root.rglob(name))
    data, rng = path.read_bytes(), random.Random(0)
    attack(path, lambda: mutated_bytes(data, rng), lambda: import_hacpp(model.root), 60)


@pytest.mark.parametrize("value", [*HOSTILE, 1e6, 0.0199, 0.02, "0.02"], ids=lambda value: repr(value)[:20])
@pytest.mark.parametrize("name", ["metrics.json", "cfg_args"])
def test_hostile_voxel_sizes_are_one_error(model, name, value):
    """A wrong voxel size is an error, and a missing one is inferred."""
    model.write()
    (model.root / "bitstreams" / "xyz_gpcc.npz").unlink()
    text = json.dumps({"voxel_size": value})
    (model.root / name).write_text(
        text if name == "metrics.json" else f"Namespace(voxel_size={value!r})".replace("\ud800", "")
    )
    try:
        assert import_hacpp(model.root).coding.voxel_size == 0.02
    except DatasetError as error:
        assert str(model.root) in str(error)  # noqa: PT017
        assert value not in (0.02, None)


def test_voxel_size_larger_than_the_scene_is_refused(model):
    model.write()
    (model.root / "bitstreams" / "xyz_gpcc.npz").unlink()
    (model.root / "cfg_args").write_text("Namespace(voxel_size=1e6)")
    with pytest.raises(DatasetError, match=r"not whole multiples.*voxel size comes from .*cfg_args"):
        import_hacpp(model.root)


def test_a_model_in_map_coordinates_is_refused_with_the_way(model):
    model.positions = (model.positions + np.array([451234.0, 5411876.0, 118.0])).astype(np.float32)
    model.write()
    message = r"anchors are around \(45123\d\S*, 5.41188e\+06, 11\S+\).*steps of 0.5 for voxels of .*train again"
    with pytest.raises(DatasetError, match=message):
        import_hacpp(model.root)
