import pytest

from scenes import tiny_scene
from splatwire.anchors.voxels import voxel_indices
from splatwire.codec import scene_in_order
from splatwire.codec.anchors.hacpp.fit import fit_side_info
from splatwire.codec.anchors.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.types import AnchorScene


@pytest.fixture(scope="session")
def scene() -> AnchorScene:
    return scene_in_order(tiny_scene(seed=3, num_anchors=700), "morton")


@pytest.fixture(scope="session")
def side_info_bytes(scene: AnchorScene) -> bytes:
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    return write_side_info(fit_side_info(scene, voxels))


@pytest.fixture(scope="session")
def side_info(scene: AnchorScene, side_info_bytes: bytes) -> SideInfo:
    return read_side_info(side_info_bytes, scene.anchors.num_anchors, "morton")
