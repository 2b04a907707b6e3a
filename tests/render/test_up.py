"""What is up is where the light comes from, if there is any doubt at all."""

import pytest
import torch

from splatwire.model.splat_scene import SplatScene
from splatwire.render.up import up_of
from splatwire.scene.splats import Splats


def lit_ball(up: float, strength: float) -> SplatScene:
    """A ball whose side towards `up` along y is the brighter one."""
    rng = torch.Generator().manual_seed(1)
    means = torch.nn.functional.normalize(torch.randn(800, 3, generator=rng), dim=1)
    sh = torch.zeros(800, 1, 3) - 1.0
    sh += strength * up * means[:, 1, None, None]
    turns = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(800, 1)
    return SplatScene(Splats(means, turns, torch.full((800, 3), 0.08), torch.full((800,), 0.95), sh))


@pytest.mark.parametrize(("up", "strength", "found"), [(1, 0.6, "y"), (-1, 0.6, "-y"), (1, 0.02, "-y"), (1, 0, "-y")])
def test_the_brighter_side_is_up_and_minus_y_where_neither_is(up: float, strength: float, found: str) -> None:
    assert up_of(lit_ball(up, strength)) == found
