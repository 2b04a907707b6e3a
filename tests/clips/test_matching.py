"""Partners from frame to frame where rows say nothing."""

import numpy as np
import torch
from scipy.spatial import cKDTree

from splatwire.clips.matching import match
from splatwire.scene.splats import Splats

COUNT = 4000


def random_splats(rng: np.random.Generator) -> Splats:
    """Gaussians of many colours and sizes all over a cube."""
    means, quats = rng.uniform(-1, 1, (COUNT, 3)), rng.normal(size=(COUNT, 4))
    columns = (
        means, quats / np.linalg.norm(quats, axis=1, keepdims=True), np.exp(rng.normal(-4, 0.5, (COUNT, 3))),
        rng.uniform(0.1, 0.99, COUNT), rng.normal(size=(COUNT, 1, 3)),
    )  # fmt: skip
    return Splats(*(torch.from_numpy(column).float() for column in columns))


def bent(splats: Splats) -> Splats:
    """One half stands still, the other bends, by up to several times what neighbours are apart."""
    means = splats.means.double()
    shift = torch.sin(2 * means[:, [1]]) * means[:, [0]].clamp(min=0) * torch.tensor([[0.1, 0.3, 0.15]])
    return Splats((means + shift).float(), splats.quats, splats.scales, splats.opacities, splats.sh)


def test_partners_are_found_where_half_bends_farther_than_neighbours_are_apart():
    rng = np.random.default_rng(3)
    before, order = random_splats(rng), rng.permutation(COUNT)
    after = bent(before)
    moved = (after.means - before.means).norm(dim=1)
    apart = np.median(cKDTree(before.means.numpy()).query(before.means.numpy(), k=2)[0][:, 1])
    assert moved.median() < 0.1 * apart
    assert moved.quantile(0.9) > 1.5 * apart
    found = match(before, after.select(torch.from_numpy(order)))
    assert (found.partner == order).mean() > 0.995
    velocity = (after.means - before.means).numpy()[order]
    assert np.quantile(np.abs(found.velocity - velocity).max(axis=1), 0.99) < 1e-4


def test_partners_are_found_where_all_look_the_same_but_for_rounding():
    rng = np.random.default_rng(5)
    before, order = random_splats(rng), rng.permutation(COUNT)
    grey = (torch.full((COUNT, 3), 0.02), torch.full((COUNT,), 0.7))
    noise = torch.from_numpy(rng.normal(size=(2, COUNT, 1, 3)) * 1e-6).float()
    drift = torch.from_numpy(rng.normal(size=(COUNT, 3)) * 0.01).float()
    one = Splats(before.means, before.quats, *grey, noise[0])
    two = Splats(before.means + drift, before.quats, *grey, noise[1])
    assert match(one, two.select(torch.from_numpy(order))).share > 0.95
