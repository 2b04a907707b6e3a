"""Initial viewpoint and up axis of a scene."""

import struct

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream.sections import sections_of
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.initial_view import SECTION, UP_SECTION, initial_view_section, up_axis, up_sections
from splatwire.errors import BitstreamError


def nine(section: bytes) -> np.ndarray:
    return np.array(struct.unpack("<9f", section)).reshape(3, 3)


def test_viewpoint_of_orbit_cameras_is_the_first_camera_and_the_common_target():
    cameras = tiny_cameras(5)
    eye, target, up = nine(initial_view_section(cameras))
    assert np.allclose(eye, cameras.centers[0], atol=1e-5)
    assert np.linalg.norm(target) < 1e-3
    assert up[1] < -0.98
    assert abs(float(np.linalg.norm(up)) - 1) < 1e-5


def test_viewpoint_of_one_or_parallel_cameras_is_straight_ahead():
    for cameras in (tiny_cameras(1), tiny_cameras(1).select([0, 0])):
        eye, target, _ = nine(initial_view_section(cameras))
        ahead = (target - eye) / np.linalg.norm(target - eye)
        assert np.allclose(ahead, cameras.viewmats[0, 2, :3], atol=1e-3)


def test_viewpoint_is_hidden_from_concealers():
    stream = with_section(encode_scene(tiny_scene(seed=2)), SECTION, initial_view_section(tiny_cameras()))
    assert SECTION in sections_of(stream)
    assert SECTION not in decode_stream(stream).sections


def test_up_axis_round_trips():
    assert [up_axis(up_sections(axis)) for axis in ("y", "-y", "z", "-z")] == ["y", "-y", "z", "-z"]
    with pytest.raises(BitstreamError, match="no axis"):
        up_axis({UP_SECTION: b"\xffside"})
