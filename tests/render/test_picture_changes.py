"""The change of pictures that a changed Gaussian causes, against pictures with only this change."""

from dataclasses import replace

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.render import render_scene
from splatwire.render.importance import cameras_around
from splatwire.render.picture_changes import picture_changes
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

DRAWS = 100
SCENE = replace(some_splats(12), scales=np.full((12, 3), 0.15, np.float32))
CAMERAS = cameras_around(SCENE.means, 2, 24)


def pictures(splats: Splats) -> np.ndarray:
    return np.asarray(render_scene(SplatScene(splats), CAMERAS), np.float64)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "step"), [("means", 0.01), ("scales", 0.01), ("opacities", -0.05), ("sh", 0.1)])
def test_changes_are_those_of_pictures_with_one_changed_gaussian(name: str, step: float) -> None:
    after = replace(SCENE, **{name: getattr(SCENE, name) + np.float32(step)})
    found = np.mean([picture_changes(SCENE, after, CAMERAS, seed) for seed in range(DRAWS)], axis=0)
    for row in range(SCENE.num_gaussians):
        values = getattr(after, name).copy()
        values[row] = getattr(SCENE, name)[row]
        wanted = ((pictures(after) - pictures(replace(after, **{name: values}))) ** 2).sum()
        assert found[row] == pytest.approx(wanted, rel=0.6)


def test_unchanged_and_unseen_gaussians_change_no_picture() -> None:
    means, beside = SCENE.means.copy(), np.cross(*CAMERAS.viewmats[:, 2, :3])
    means[:2] += (1e3 * beside / np.linalg.norm(beside)).astype(np.float32)
    before = replace(SCENE, means=means)
    sh = before.sh + np.float32(0.1)
    sh[4:6] = before.sh[4:6]
    found = picture_changes(before, replace(before, sh=sh), CAMERAS)
    assert np.flatnonzero(found == 0).tolist() == [0, 1, 4, 5]
