"""Laws of incremental concealment: at every moment what concealing from scratch makes of what is there."""

import dataclasses

import numpy as np
import pytest
import torch

from conceal.gaps import random_context
from scenes import tiny_scene
from splatwire.conceal import Drop, Grow, conceal, create_concealer, progressive
from splatwire.conceal.progressive import ProgressiveConcealer
from splatwire.model import AnchorScene, Partial
from splatwire.paper import Cari, Idw, PriorMean
from splatwire.scene import AnchorLayout, Anchors, Attribute, Erasures

EXACT = [Drop(), Grow(neighbors=16), Grow(neighbors=7, exponent=1.0, max_excess=2.0)]


class Transfer:
    """A hand-made scene whose anchors arrive."""

    def __init__(self, num_anchors: int, seed: int, *, lattice: bool = False) -> None:
        full = random_context(num_anchors, seed, loss=0)
        positions = full.scene.anchors.positions
        if lattice:
            positions = (positions * 8).round() / 8
        order = torch.from_numpy(np.lexsort((positions.numpy() // 0.5).T))  # nearby in space, nearby in rank
        self.truth = dataclasses.replace(full.scene.anchors, positions=positions).select(order)
        empty = Anchors(
            self.truth.positions, *(torch.zeros_like(t) for t in (
                self.truth.features, self.truth.scalings, self.truth.offsets, self.truth.mask)),
        )  # fmt: skip
        model = tiny_scene(num_anchors=10)
        layout = dataclasses.replace(model.coding.config, layout=full[AnchorLayout])
        scene = AnchorScene(empty, model.heads, dataclasses.replace(model.coding, config=layout))
        erasures = Erasures(torch.zeros(num_anchors, len(Attribute), dtype=torch.bool))
        self.partial = Partial(scene, erasures, {}, full.said)
        self.order = np.random.default_rng(seed).permutation(num_anchors)

    def arrive(self, ranks: np.ndarray) -> np.ndarray:
        rows = torch.from_numpy(ranks)
        for name in ("features", "scalings", "offsets", "mask"):
            getattr(self.partial.scene.anchors, name)[rows] = getattr(self.truth, name)[rows]
        self.partial.erasures.received[rows] = True
        return ranks

    def forget(self) -> None:
        for name in ("features", "scalings", "offsets", "mask"):
            getattr(self.partial.scene.anchors, name).zero_()
        self.partial.erasures.received.zero_()


def assert_same(got: AnchorScene, expected: AnchorScene) -> None:
    for name in ("positions", "features", "scalings", "offsets", "mask"):
        assert torch.equal(getattr(got.anchors, name), getattr(expected.anchors, name)), name
    gains, left_out = torch.ones(len(got.positions)), torch.zeros(len(got.positions), dtype=torch.bool)
    if expected.hints is not None:  # there are none where nothing is lost
        gains, left_out = expected.hints.size_gain, expected.hints.left_out
    if got.hints is not None:
        assert torch.equal(got.hints.left_out, left_out)
        torch.testing.assert_close(got.hints.size_gain, gains, rtol=1e-6, atol=0)


@pytest.mark.parametrize("concealer", EXACT, ids=repr)
@pytest.mark.parametrize("step", [1, 13, 90])
def test_every_moment_equals_concealing_from_scratch(concealer, step):
    transfer = Transfer(num_anchors={1: 25, 13: 100, 90: 500}[step], seed=step)
    progressive = ProgressiveConcealer(transfer.partial, concealer)
    assert progressive.incremental
    assert_same(progressive.scene(), conceal(transfer.partial, concealer))
    for number, start in enumerate(range(0, len(transfer.order), step)):
        progressive.arrived(transfer.arrive(transfer.order[start : start + step]))
        if step > 1 or number < 10:
            assert_same(progressive.scene(), conceal(transfer.partial, concealer))
    scene = progressive.scene()
    assert_same(scene, conceal(transfer.partial, concealer))
    assert torch.equal(scene.anchors.features, transfer.truth.features)


@pytest.mark.parametrize("concealer", EXACT, ids=repr)
def test_anchors_at_equal_distances_and_at_one_place(concealer):
    transfer = Transfer(num_anchors=300, seed=4, lattice=True)
    progressive = ProgressiveConcealer(transfer.partial, concealer)
    for start in range(0, 300, 20):
        progressive.arrived(transfer.arrive(transfer.order[start : start + 20]))
        expected = conceal(transfer.partial, concealer)
        assert_same(progressive.scene(), expected)
        assert torch.equal(progressive.scene().anchors.features, expected.anchors.features)


@pytest.mark.parametrize("concealer", [Drop(), Grow(), Idw(), PriorMean()], ids=repr)
def test_it_may_begin_in_the_middle_of_a_transfer(concealer):
    transfer = Transfer(num_anchors=400, seed=8)
    transfer.arrive(transfer.order[:150])
    progressive = ProgressiveConcealer(transfer.partial, concealer)
    assert_same(progressive.scene(), conceal(transfer.partial, concealer))
    progressive.arrived(transfer.arrive(transfer.order[150:170]))
    progressive.arrived(transfer.order[160:170])  # told twice
    progressive.scene()
    progressive.arrived(transfer.order[140:160])
    assert_same(progressive.scene(), conceal(transfer.partial, concealer))


@pytest.mark.parametrize("concealer", [Drop(), Grow(), Idw(), PriorMean(), Cari()], ids=repr)
def test_it_may_start_over(concealer):
    transfer = Transfer(num_anchors=200, seed=8)
    progressive = ProgressiveConcealer(transfer.partial, concealer)
    progressive.arrived(transfer.arrive(transfer.order[:150]))
    progressive.scene()
    transfer.forget()
    progressive.restart()
    assert_same(progressive.scene(), conceal(transfer.partial, concealer))
    progressive.arrived(transfer.arrive(transfer.order[50:190]))
    assert_same(progressive.scene(), conceal(transfer.partial, concealer))


@pytest.mark.parametrize("name", ["cari"])
def test_other_concealers_work_from_scratch_and_say_so(name):
    transfer = Transfer(num_anchors=300, seed=9)
    progressive = ProgressiveConcealer(transfer.partial, name)
    assert not progressive.incremental
    for start in range(0, 300, 100):
        progressive.arrived(transfer.arrive(transfer.order[start : start + 100]))
        assert_same(progressive.scene(), conceal(transfer.partial, create_concealer(name)))
    assert progressive.scene() is progressive.scene()


def test_what_is_not_supported_says_so():
    transfer = Transfer(num_anchors=50, seed=1)
    assert not ProgressiveConcealer(transfer.partial, Idw()).incremental
    assert not ProgressiveConcealer(transfer.partial, Cari()).incremental
    transfer.partial.erasures.received[:10, int(Attribute.FEATURE)] = True  # packets of single attributes
    assert not ProgressiveConcealer(transfer.partial, Grow()).incremental


def test_the_work_follows_what_changed():
    """A late arrival touches some dozens of rows out of thousands."""
    transfer = Transfer(num_anchors=6000, seed=12)
    progressive = ProgressiveConcealer(transfer.partial, Grow())
    progressive.arrived(transfer.arrive(transfer.order[:4000]))
    progressive.scene()
    before = progressive.recomputed
    progressive.arrived(transfer.arrive(transfer.order[4000:4010]))
    progressive.scene()
    assert 0 < progressive.recomputed - before <= 10 * 200
    assert_same(progressive.scene(), conceal(transfer.partial, Grow()))


def test_few_arrivals_wake_no_threads_and_threads_change_no_bit(monkeypatch):
    scenes, seen, before = [], [], torch.get_num_threads()
    take = progressive._State.take
    monkeypatch.setattr(
        progressive._State, "take",
        lambda state, arrivals: (seen.append((len(arrivals), torch.get_num_threads())), take(state, arrivals))[1],
    )  # fmt: skip
    try:
        for few in (0, 1 << 12):  # more than a few, and a few
            torch.set_num_threads(2)
            monkeypatch.setattr(progressive, "_FEW", few)
            transfer = Transfer(6000, seed=4)
            concealed = ProgressiveConcealer(transfer.partial, Grow())
            for ranks in np.split(transfer.order[:5500], [5000]):
                concealed.arrived(transfer.arrive(ranks))
                scene = concealed.scene()
            scenes.append(scene)
            assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert seen == [(5000, 2), (500, 2), (5000, 2), (500, 1)]
    for name in ("features", "scalings", "offsets", "mask"):
        assert torch.equal(getattr(scenes[0].anchors, name), getattr(scenes[1].anchors, name)), name
