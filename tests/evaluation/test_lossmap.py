import numpy as np

from scenes import tiny_cameras
from splatwire.evaluation.lossmap import LOST_COLOR, RECEIVED_COLOR, draw_loss_map


def _one_element_at(position):
    return np.array([position])


def test_anchor_at_the_view_centre_is_drawn_at_the_centre():
    cameras = tiny_cameras(2, 64, 48)
    picture = np.ones((48, 64, 3), np.float32)
    for known, color in ((True, RECEIVED_COLOR), (False, LOST_COLOR)):
        pixels = draw_loss_map(_one_element_at([0.0, 0.0, 0.0]), np.array([known]), cameras, 0, picture)
        drawn = (pixels == color).all(axis=2).nonzero()
        assert drawn[0].min() in (23, 24)
        assert drawn[1].min() in (31, 32)
        assert len(drawn[0]) == 4


def test_anchors_behind_the_camera_are_not_drawn():
    cameras = tiny_cameras(2, 64, 48)
    pixels = draw_loss_map(
        _one_element_at([0.0, 0.0, -30.0]), np.array([False]), cameras, 0, np.ones((48, 64, 3), np.float32)
    )
    assert (pixels == pixels[0, 0]).all()
