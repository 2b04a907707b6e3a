"""Matching of Gaussians between frames with shuffled rows."""

import numpy as np
from scipy.spatial import cKDTree

from splatwire.sequence.matching import match
from splatwire.types.splats import Splats

COUNT = 4000


def random_splats(rng: np.random.Generator) -> Splats:
    """Gaussians of random colours and sizes in a cube."""
    means, quats = rng.uniform(-1, 1, (COUNT, 3)), rng.normal(size=(COUNT, 4))
    columns = (
        means, quats / np.linalg.norm(quats, axis=1, keepdims=True), np.exp(rng.normal(-4, 0.5, (COUNT, 3))),
        rng.uniform(0.1, 0.99, COUNT), rng.normal(size=(COUNT, 1, 3)),
    )  # fmt: skip
    return Splats(*(column.astype(np.float32) for column in columns))


def bent(splats: Splats) -> Splats:
    """One half is static; the other bends by several times the distance of neighbours."""
    means = splats.means.astype(np.float64)
    shift = np.sin(2 * means[:, [1]]) * means[:, [0]].clip(0) * np.array([[0.1, 0.3, 0.15]], np.float32)
    return Splats((means + shift).astype(np.float32), splats.quats, splats.scales, splats.opacities, splats.sh)


def test_matching_survives_motion_larger_than_neighbour_distance():
    rng = np.random.default_rng(3)
    before, order = random_splats(rng), rng.permutation(COUNT)
    after = bent(before)
    moved = np.linalg.norm(after.means - before.means, axis=1)
    apart = np.median(cKDTree(before.means).query(before.means, k=2)[0][:, 1])
    assert np.median(moved) < 0.1 * apart
    assert np.quantile(moved, 0.9) > 1.5 * apart
    found = match(before, after.select(order))
    assert (found.partner == order).mean() > 0.995
    velocity = (after.means - before.means)[order]
    assert np.quantile(np.abs(found.velocity - velocity).max(axis=1), 0.99) < 1e-4


def test_matching_survives_identical_appearance():
    rng = np.random.default_rng(5)
    before, order = random_splats(rng), rng.permutation(COUNT)
    grey = (np.full((COUNT, 3), 0.02, np.float32), np.full((COUNT,), 0.7, np.float32))
    noise = (rng.normal(size=(2, COUNT, 1, 3)) * 1e-6).astype(np.float32)
    drift = (rng.normal(size=(COUNT, 3)) * 0.01).astype(np.float32)
    one = Splats(before.means, before.quats, *grey, noise[0])
    two = Splats(before.means + drift, before.quats, *grey, noise[1])
    assert match(one, two.select(order)).share > 0.95
