import dataclasses

import numpy as np
import pytest

from close import assert_close
from concealment.gaps import gaussians, random_context
from random_numbers import Numbers
from splatwire.concealment import Drop, Grow
from splatwire.concealment.grow import lost_share
from splatwire.errors import InvalidValueError
from splatwire.types import LossMask, Prior


def test_gain_is_the_inverse_square_root_of_the_received_share() -> None:
    context = random_context(200, 1)
    known, positions = context.loss_mask.fully_received, context.scene.anchors.positions.astype(np.float64)
    result = Grow(neighbors=10, max_gain=100.0, max_excess=float("inf"))(context)
    assert np.array_equal(result.left_out, ~known)
    for k in range(200):
        if not known[k]:
            assert result.size_gain[k] == 1
            continue
        near = np.linalg.norm(positions - positions[k], axis=1).argsort()[1:11]
        size = np.exp(np.log(context[Prior].scaling.mean[near, 3:].astype(np.float64)).mean(axis=1))
        lost = float((size * ~known[near]).sum() / size.sum())
        assert float(result.size_gain[k]) == pytest.approx(
            min((1 - lost) ** -0.5, 100.0) if lost < 1 else 100.0, rel=1e-5
        )


def test_lost_small_anchors_weigh_less_than_large_ones() -> None:
    context = random_context(300, 6, loss=0)
    size = np.log(context[Prior].scaling.mean[:, 3:]).mean(axis=1)
    large = size >= np.median(size)

    def gain(known: np.ndarray) -> float:
        gains = Grow(neighbors=20)(dataclasses.replace(context, loss_mask=LossMask.of_elements(known))).size_gain
        return float(gains[known].mean())

    assert gain(large) < 1.35 < 1.45 < gain(~large)


def test_equal_weights_give_the_share_by_count() -> None:
    context = random_context(200, 7)
    positions, known = context.scene.anchors.positions, context.loss_mask.fully_received
    heads = lost_share(positions, known, 9)
    assert np.array_equal(heads, lost_share(positions, known, 9, np.full((200,), 3.0, np.float32)))
    assert float(heads[known].max()) <= 1
    assert_close((9 * heads).round(), 9 * heads)


@pytest.mark.parametrize("exponent", [0.0, 0.25, 1.0])
def test_isolated_anchor_reaches_the_gain_limit(exponent: float) -> None:
    context = random_context(100, 2, loss=0)
    known = np.zeros(100, np.bool_)
    known[3] = True
    context = dataclasses.replace(context, loss_mask=LossMask.of_elements(known))
    gain = Grow(exponent=exponent, max_gain=3.0)(context).size_gain
    assert float(gain[3]) == pytest.approx(3.0 if exponent else 1.0)
    assert bool((gain[~known] == 1).all())


def test_partially_received_anchor_is_left_out() -> None:
    context = random_context(80, 3, separated=True)
    assert np.array_equal(Drop()(context).left_out, ~context.loss_mask.received.all(axis=1))
    assert bool((Drop()(context).size_gain == 1).all())
    assert np.array_equal(Grow()(context).left_out, Drop()(context).left_out)


def test_local_gain_is_limited_relative_to_the_global_gain() -> None:
    context = random_context(400, 5)
    kept = float(context.loss_mask.fully_received.astype(np.float64).mean())
    gain = Grow(max_excess=1.02, neighbors=8)(context).size_gain
    assert float(gain.max()) == pytest.approx(1.02 * kept**-0.5)
    free = Grow(max_excess=float("inf"), neighbors=8)(context).size_gain
    assert_close(gain, free.clip(None, 1.02 * kept**-0.5))


@pytest.mark.parametrize("options", [{"max_excess": 0.5}, {"neighbors": 0}, {"exponent": -0.5}, {"max_gain": 0.9}])
def test_invalid_settings_are_refused(options: dict) -> None:
    with pytest.raises(InvalidValueError):
        Grow(**options)


def test_gaussians_gain_the_opacity_of_lost_neighbours() -> None:
    rng = Numbers(3)
    positions, opacities = (
        rng.rand(400, 3),
        rng.rand(400) * 0.98 + 0.01,
    )
    known = np.arange(400) % 2 == 0
    hints = Grow()(gaussians(positions, opacities, known))
    assert np.array_equal(hints.left_out, ~known)
    seen = (opacities * hints.opacity_gain)[known]
    through, alone = 1 - seen, 1 - opacities[known]
    assert float(np.median(np.log(through) / np.log(alone))) == pytest.approx(2**0.8, rel=0.1)
    assert bool((seen < 1).all())
    assert 1.0 < float(hints.size_gain[known].max()) < 1.15
    assert bool((hints.size_gain[~known] == 1).all() and (hints.opacity_gain[~known] == 1).all())


def test_gaussians_without_lost_neighbours_are_unchanged() -> None:
    known = np.ones(50, np.bool_)
    opacities = np.linspace(0.1, 0.9, 50)
    hints = Grow()(gaussians(Numbers(0).rand(50, 3), opacities, known))
    assert_close(hints.opacity_gain, np.ones(50, np.float32))
    assert_close(hints.size_gain, np.ones(50, np.float32))
