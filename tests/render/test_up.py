"""The up axis points to the brighter side of the scene, with a default in case of doubt."""

from dataclasses import replace

import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from splatwire.codec.initial_view import UP_SECTION
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.render.up import estimate_up_axis
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats


def lit_ball(up: float, strength: float) -> SplatScene:
    """A ball with a brighter side towards `up` along y."""
    rng = Numbers(1)
    means = unit(rng.randn(800, 3))
    sh = np.zeros((800, 1, 3), np.float32) - 1.0
    sh += strength * up * means[:, 1, None, None]
    turns = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (800, 1))
    return SplatScene(Splats(means, turns, np.full((800, 3), 0.08, np.float32), np.full((800,), 0.95, np.float32), sh))


@pytest.mark.parametrize(("up", "strength", "found"), [(1, 0.6, "y"), (-1, 0.6, "-y"), (1, 0.02, "-y"), (1, 0, "-y")])
def test_up_axis_is_the_brighter_side_or_minus_y(up: float, strength: float, found: str) -> None:
    assert estimate_up_axis(lit_ball(up, strength)) == found


@pytest.mark.parametrize("factor", [2.0**-20, 2.0**-10, 2.0**10, 2.0**20])
def test_up_axis_does_not_depend_on_the_unit_of_length(factor: float) -> None:
    ball = lit_ball(1, 0.6).splats
    size = np.float32(factor)
    assert estimate_up_axis(SplatScene(replace(ball, means=ball.means * size, scales=ball.scales * size))) == "y"


@pytest.mark.parametrize("up", ["y", "-y"])
@pytest.mark.parametrize("strength", [0.6, -0.6])
def test_up_axis_follows_objects_standing_on_a_ground(up: str, strength: float) -> None:
    ball = lit_ball(1, strength).splats
    ground = replace(ball, means=ball.means * 0.01 + 20 * Numbers(4).rand(800, 3))
    ground.means[:, 1] *= 0.001
    sign = 1.0 if up == "y" else -1.0
    ground.means[::8, 1] += sign * 2 * Numbers(5).rand(100)
    assert estimate_up_axis(SplatScene(ground)) == up


def test_up_axis_of_a_clip_is_detected_and_can_be_overridden() -> None:
    frames, sections = [lit_ball(1, 0.6).splats] * 2, []
    for options in (SequenceOptions(), SequenceOptions(up="-y"), SequenceOptions(up="z")):
        stream, _ = encode_sequence(frames, options)
        sections.append(open_side_info(stream.manifest, stream.side_info).sections.get(UP_SECTION))
    assert sections == [b"y", None, b"z"]
