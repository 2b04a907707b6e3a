"""What is up is where the light comes from, if there is any doubt at all."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from close import unit
from splatwire.clips import ClipOptions, encode_clip
from splatwire.codec.schemas.tracks.side_info import open_side_info
from splatwire.codec.viewpoint import UP_SECTION
from splatwire.model.splat_scene import SplatScene
from splatwire.render.up import up_of
from splatwire.scene.splats import Splats


def lit_ball(up: float, strength: float) -> SplatScene:
    """A ball whose side towards `up` along y is the brighter one."""
    rng = torch.Generator().manual_seed(1)
    means = unit(torch.randn(800, 3, generator=rng).numpy())
    sh = np.zeros((800, 1, 3), np.float32) - 1.0
    sh += strength * up * means[:, 1, None, None]
    turns = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (800, 1))
    return SplatScene(Splats(means, turns, np.full((800, 3), 0.08, np.float32), np.full((800,), 0.95, np.float32), sh))


@pytest.mark.parametrize(("up", "strength", "found"), [(1, 0.6, "y"), (-1, 0.6, "-y"), (1, 0.02, "-y"), (1, 0, "-y")])
def test_the_brighter_side_is_up_and_minus_y_where_neither_is(up: float, strength: float, found: str) -> None:
    assert up_of(lit_ball(up, strength)) == found


@pytest.mark.parametrize("up", ["y", "-y"])
@pytest.mark.parametrize("strength", [0.6, -0.6])
def test_of_a_ground_what_stands_on_it_says_where_up_is(up: str, strength: float) -> None:
    ball = lit_ball(1, strength).splats
    ground = replace(
        ball, means=ball.means * 0.01 + 20 * torch.rand(800, 3, generator=torch.Generator().manual_seed(4)).numpy()
    )
    ground.means[:, 1] *= 0.001
    sign = 1.0 if up == "y" else -1.0
    ground.means[::8, 1] += sign * 2 * torch.rand(100, generator=torch.Generator().manual_seed(5)).numpy()
    assert up_of(SplatScene(ground)) == up


def test_a_clip_is_told_as_a_scene_is_and_may_be_overridden() -> None:
    frames, sections = [lit_ball(1, 0.6).splats] * 2, []
    for options in (ClipOptions(), ClipOptions(up="-y"), ClipOptions(up="z")):
        stream, _ = encode_clip(frames, options)
        sections.append(open_side_info(stream.manifest, stream.side_info).sections.get(UP_SECTION))
    assert sections == [b"y", None, b"z"]
