import numpy as np
import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import InvalidValueError
from splatwire.evaluate.damage import measure_damage, without
from splatwire.model import PartialScene
from splatwire.render.importance import footprint_importance


@pytest.fixture(scope="module")
def complete() -> PartialScene:
    return decode_stream(encode_scene(tiny_scene()))


def test_losing_more_of_what_matters_costs_more(complete: PartialScene) -> None:
    cameras = tiny_cameras()
    tiers = footprint_importance(complete.scene, cameras).tiers((0.3,))
    damage = measure_damage(complete, tiers, cameras, concealer="drop", seed=1)
    assert damage.mse.shape == (2, 4)
    assert (damage.mse[:, 0] == 0).all()
    assert (np.diff(damage.mse, axis=1) >= 0).all()
    assert damage.mse[0, -1] > damage.mse[1, -1] > 0


def test_what_is_lost_is_gone_and_the_rest_untouched(complete: PartialScene) -> None:
    num = complete.scene.anchors.num_anchors
    known = torch.arange(num) % 3 > 0
    partial = without(complete, known)
    assert torch.equal(partial.erasures.known, known)
    before, after = complete.scene.anchors, partial.scene.anchors
    for name in ("features", "scalings", "offsets", "mask"):
        assert torch.equal(getattr(after, name)[known], getattr(before, name)[known])
        assert not bool(getattr(after, name)[~known].any())
    assert torch.equal(after.positions, before.positions)


def test_damage_needs_a_complete_stream(complete: PartialScene) -> None:
    num = complete.scene.anchors.num_anchors
    partial = without(complete, torch.arange(num) > 0)
    with pytest.raises(InvalidValueError, match="1 anchors are lost"):
        measure_damage(partial, torch.zeros(num, dtype=torch.uint8), tiny_cameras(), concealer="drop")
