import json

import numpy as np
import pytest

from splatwire.data.transforms_json import read_transforms
from splatwire.errors import DatasetError


def test_blender_poses_become_opencv(capture):
    views = read_transforms(capture.write_blender() / "transforms_test.json")
    assert [view.name for view in views] == [f"test/r_{i}" for i in range(8, 12)]
    for i, view in enumerate(views, start=8):
        np.testing.assert_allclose(view.viewmat, capture.viewmat(i), atol=1e-9)
        np.testing.assert_allclose(view.K, [[33, 0, 20], [0, 33, 12], [0, 0, 1]], atol=1e-9)
        assert view.image_path == capture.root / "test" / f"r_{i}.png"


def test_nerfstudio_intrinsics_are_taken_as_given(capture):
    views = read_transforms(capture.write_nerfstudio() / "transforms.json")
    for i, view in enumerate(views):
        np.testing.assert_allclose(view.viewmat, capture.viewmat(i), atol=1e-9)
        assert view.K.tolist() == [[33, 0, 19.5], [0, 35, 12.25], [0, 0, 1]]


def test_intrinsics_of_a_frame_win(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][5]["fl_x"] = 50
    path.write_text(json.dumps(content))
    assert [view.K[0, 0] for view in read_transforms(path)] == [33] * 5 + [50] + [33] * 6


def frame(**values):
    return lambda content: content["frames"][2].update(values)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda content: content.update(frames=[]), "has no views"),
        (lambda content: content.pop("frames"), "has no views"),
        (frame(file_path=3), "frame 2 has no 'file_path'"),
        (frame(file_path="images/absent.png"), "'images/absent.png' is missing"),
        (frame(file_path="../view_00.png"), "does not stay inside"),
        (frame(file_path="/etc/passwd"), "does not stay inside"),
        (frame(transform_matrix=None), "expected 4 x 4 numbers"),
        (frame(transform_matrix=[[float("nan")] * 4] * 4), "not finite"),
        (frame(transform_matrix=(3 * np.eye(4)).tolist()), "not a rotation"),
        (frame(k3=0.1), "a lens \\(k3\\)"),
        (frame(camera_model="OPENCV_FISHEYE"), "a lens \\(camera_model\\)"),
        (frame(fl_x="wide"), "'fl_x' is not a sensible number"),
        (frame(w=0), "image size of 0 x 24"),
        (lambda content: content.pop("fl_x"), "neither 'fl_x' nor"),
    ],
)
def test_wrong_files_are_refused(spoil, reason, capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=reason) as caught:
        read_transforms(path)
    assert "transforms.json" in str(caught.value)
