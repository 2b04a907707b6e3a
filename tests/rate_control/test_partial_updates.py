"""Updates with a share of the changes lead to the scene that an update with all changes gives."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.codec import apply_update, decode_stream, encode_update
from splatwire.codec.update.section import manifest_digest, update_name
from splatwire.errors import InvalidValueError
from splatwire.rate_control.partial_updates import PartialUpdates, match_by_position
from splatwire.types.splats import Splats


def trained(splats: Splats, seed: int = 0, step: float = 0.1) -> Splats:
    """Gaussians with all attributes changed, as in a training step."""
    draw = np.random.default_rng(seed)

    def jitter(values: np.ndarray) -> np.ndarray:
        return (values + step * draw.normal(size=values.shape)).astype(np.float32)

    return replace(
        splats, means=jitter(splats.means), scales=splats.scales * np.exp(jitter(np.zeros_like(splats.scales))),
        opacities=np.clip(jitter(splats.opacities), 0.01, 0.99), sh=jitter(splats.sh),
    )  # fmt: skip


def joined(*parts: Splats) -> Splats:
    return Splats(*(np.concatenate(values) for values in zip(*(vars(part).values() for part in parts), strict=True)))


def next_name(scene: SceneStream) -> str:
    return update_name(manifest_digest(scene.manifest))


def transparent(splats: Splats) -> Splats:
    opacities = splats.opacities.copy()
    opacities[::3] = 0
    return replace(splats, opacities=opacities)


NEXT = {
    "all change": trained,
    "fewer": lambda splats: trained(splats.select(np.arange(100, 450)), step=0.01),
    "more": lambda splats: joined(trained(splats, step=0.01), trained(splats.select(np.arange(200)), 1)),
    "clones": lambda splats: joined(splats, splats.select(np.arange(0, 200))),
    "pruned and split": lambda splats: joined(splats.select(np.arange(60, 500)), trained(splats.slice_range(0, 90), 2)),
    "other order": lambda splats: trained(splats).select(np.random.default_rng(3).permutation(500)),
    "some become transparent": transparent,
}


@pytest.mark.parametrize(
    ("change", "restarts"), [(trained, False), (lambda splats: joined(*[splats] * 3), True)], ids=["update", "restart"]
)
def test_all_states_have_the_origin_background_and_antialiasing_of_the_first(change, restarts: bool) -> None:
    origin, background = (442_000.0, 5_443_000.0, 120.0), (1.0, 0.5, 0.0)
    state = PartialUpdates.start(some_splats(), True, origin, background)
    states = [state, state.pushed(change(some_splats()), 1.0)]
    assert (states[1].num_pushed == 0) == restarts
    for scene in (decode_stream(state.chain.scene).scene for state in states):
        assert (scene.origin, scene.background, scene.antialiased) == (origin, background, True)


@pytest.mark.slow
@pytest.mark.parametrize("change", NEXT.values(), ids=NEXT)
@pytest.mark.parametrize("share", [0.25, 1.0])
def test_repeated_pushes_lead_to_the_full_encode(change, share: float) -> None:
    state = PartialUpdates.start(some_splats())
    first, newest = state.chain.scene, change(some_splats())
    for _ in range(round(2 / share)):
        before = state.chain.scene
        state = state.pushed(newest, share)
        new = state.chain.updates[-1].manifest.num_elements if state.chain.scene is not before else 0
        assert new <= round(share * newest.num_gaussians)
    expected = apply_update(first, encode_update(first, newest))
    assert stream_to_bytes(state.chain.scene) == stream_to_bytes(expected)


def test_receivers_of_every_kept_state_reach_the_newest_one() -> None:
    states = [PartialUpdates.start(some_splats())]
    for seed in range(4):
        states.append(states[-1].pushed(trained(states[-1].newest, seed)))
    offers, newest = states[-1].chain.offers(), states[-1].chain.scene
    kept = [state.chain.scene for state in states if next_name(state.chain.scene) in offers]
    assert len(kept) > 2
    for scene in kept:
        while (update := offers[next_name(scene)]) is not None:
            scene = apply_update(scene, update)
        assert stream_to_bytes(scene) == stream_to_bytes(newest)


def test_large_changes_are_sent_before_small_ones() -> None:
    splats = some_splats()
    sh, most = splats.sh + np.float32(0.15), np.argsort(-splats.scales.prod(axis=1))[:25]
    sh[most] += 5
    state = PartialUpdates.start(splats).pushed(replace(splats, sh=sh), 0.1)
    received = decode_stream(state.chain.updates[-1]).scene.splats
    assert received.num_gaussians == 50
    assert (received.sh[:, 0].mean(axis=1) > 2).sum() == 25


def test_changes_are_coarse_until_all_have_been_sent() -> None:
    splats = some_splats()
    state, newest, classes = PartialUpdates.start(splats), trained(splats), []
    for _ in range(7):
        state = state.pushed(newest, 0.25)
        classes.append(decode_stream(state.chain.updates[-1]).scene.coding.precision_classes)
    finest = max(int(each.max()) for each in classes)
    assert [bool((each == finest).all()) for each in classes] == [False] * 3 + [True] * 4
    assert state.pushed(newest, 0.25).chain is state.chain


@pytest.mark.slow
def test_the_finest_class_returns_after_no_gaussian_had_it() -> None:
    first, shell = some_splats(120), np.random.default_rng(4).normal(size=(120, 3)).astype(np.float32)
    shell /= np.linalg.norm(shell, axis=1, keepdims=True)
    newest = replace(
        first, means=shell, scales=np.full((120, 3), 0.05, np.float32), opacities=np.full(120, 0.98, np.float32),
    )  # fmt: skip
    states = [PartialUpdates.start(newest)]
    for push in range(14):
        if push < 10:
            newest = replace(newest, sh=newest.sh + np.float32(0.3))
        states.append(states[-1].pushed(newest, 0.5))
    classes = [decode_stream(state.chain.scene).scene.coding.precision_classes for state in states]
    finest = classes[0].max()
    assert (classes[0] == finest).all()
    assert (classes[10] == finest - 1).all()
    assert (classes[12] == finest).all()
    expected = apply_update(states[0].chain.scene, encode_update(states[0].chain.scene, newest))
    assert stream_to_bytes(states[-1].chain.scene) == stream_to_bytes(expected)
    for before, after in pairwise(states):
        if after.chain is not before.chain:
            update = after.chain.updates[-1]
            assert stream_to_bytes(apply_update(before.chain.scene, update)) == stream_to_bytes(after.chain.scene)


def test_a_scene_that_stays_makes_no_update() -> None:
    state = PartialUpdates.start(some_splats())
    for _ in range(2):
        state = state.pushed(some_splats())
    assert state.chain.updates == ()


@pytest.mark.parametrize("change", [
    lambda splats: joined(splats, trained(splats, 1), trained(splats, 2)),
    lambda splats: splats.select(np.arange(200)),
    lambda splats: splats.at_most_degree(0),
    lambda splats: replace(splats, means=splats.means * np.float32(1e6)),
], ids=["tripled", "below half", "degree", "far away"])  # fmt: skip
def test_the_whole_scene_is_sent_again_if_updates_do_not_fit(change) -> None:
    newest = change(some_splats())
    state = PartialUpdates.start(some_splats()).pushed(newest)
    assert stream_to_bytes(state.chain.scene) == stream_to_bytes(PartialUpdates.start(newest).chain.scene)
    assert state.chain.updates == ()


def test_a_scene_that_cannot_be_drawn_is_refused() -> None:
    splats = some_splats()
    with pytest.raises(InvalidValueError, match="no Gaussian can be drawn"):
        PartialUpdates.start(splats).pushed(replace(splats, opacities=np.zeros_like(splats.opacities)))


def test_points_are_matched_in_any_order() -> None:
    draw = np.random.default_rng(0)
    points, order = draw.random((300, 3), np.float32), draw.permutation(300)
    after = points[order] + np.float32(1e-4)
    np.testing.assert_array_equal(match_by_position(points, after), order)
    np.testing.assert_array_equal(match_by_position(points[:1], points[:3]), [0, -1, -1])


def test_changes_that_no_view_sees_are_sent_last() -> None:
    shell = np.random.default_rng(4).normal(size=(400, 3)).astype(np.float32)
    shell /= np.linalg.norm(shell, axis=1, keepdims=True)
    means = np.concatenate([shell, 0.2 * shell[:40]])
    first = some_splats(440)
    scales = np.where(np.arange(440) < 400, 0.25, 0.05).astype(np.float32)[:, None].repeat(3, axis=1)
    splats = replace(first, means=means, scales=scales, opacities=np.full(440, 0.98, np.float32))
    state, sent = PartialUpdates.start(splats), []
    for _ in range(4):
        state = state.pushed(replace(splats, sh=splats.sh + np.float32(0.1)), 0.25)
        received = decode_stream(state.chain.updates[-1]).scene.splats
        sent.append(int((np.linalg.norm(received.means, axis=1) < 0.5).sum()))
    assert sent[:3] == [0, 0, 0]
    assert sent[3] == 40
