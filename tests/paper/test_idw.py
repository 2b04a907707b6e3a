import dataclasses

import pytest
import torch

from concealment.gaps import LAYOUT
from paper.contexts import estimate, random_context
from splatwire.errors import InvalidValueError
from splatwire.paper import Idw, PriorMean
from splatwire.paper.idw import inverse_distance_weights
from splatwire.types import LossMask, Prior


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_idw_equals_a_loop(power: float) -> None:
    context = random_context(60, 1)
    known = context.loss_mask.fully_received
    anchors = context.scene.anchors
    result = estimate(Idw(neighbors=5, power=power), context)
    for q in (~known).nonzero()[:, 0].tolist():
        gaps = [
            (float((anchors.positions[q] - anchors.positions[k]).norm()), k) for k in known.nonzero()[:, 0].tolist()
        ]
        near = sorted(gaps)[:5]
        weights = torch.tensor([d**-power for d, _ in near], dtype=torch.float64)
        weights /= weights.sum()
        index = [k for _, k in near]
        features = (weights[:, None] * anchors.features[index]).sum(dim=0)
        torch.testing.assert_close(result.features[q].double(), features, rtol=1e-4, atol=1e-5)
        votes = (weights[:, None] * anchors.mask[index]).sum(dim=0)
        for s in range(LAYOUT.num_offsets):
            assert bool(result.mask[q, s]) == bool(votes[s] >= 0.5)
            if votes[s] > 0:
                mean = (weights[:, None] * anchors.offsets[index, s]).sum(dim=0) / votes[s]
                torch.testing.assert_close(result.offsets[q, s].double(), mean, rtol=1e-4, atol=1e-5)


def test_weights_are_normalised_at_any_scale() -> None:
    distance = torch.tensor([[0.0, 0.0, 1.0], [1e-30, 2e-30, 4e-30], [1e30, 2e30, 4e30], [1.0, 2.0, 4.0]])
    weight = inverse_distance_weights(distance, 1)
    wanted = torch.tensor([4 / 7, 2 / 7, 1 / 7])
    torch.testing.assert_close(weight, torch.stack([torch.tensor([0.5, 0.5, 0.0]), wanted, wanted, wanted]))


def test_coincident_neighbour_is_copied() -> None:
    context = random_context(30, 2)
    q, k = int((~context.loss_mask.fully_received).nonzero()[0]), int(context.loss_mask.fully_received.nonzero()[0])
    context.scene.anchors.positions[q] = context.scene.anchors.positions[k]
    result = estimate(Idw(), context)
    for part in ("features", "scalings", "offsets", "mask"):
        values = getattr(result, part)
        if part == "offsets":
            values = values * context.scene.anchors.mask[k][None, :, None]
        assert torch.equal(values[q], getattr(context.scene.anchors, part)[k])


def test_mahalanobis_prefers_neighbours_of_equal_extent() -> None:
    context = random_context(3, 5, loss=0)
    context.scene.anchors.positions.copy_(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]))
    context.scene.anchors.scalings[1, :3] = 0.1  # ten times its size away
    context.scene.anchors.scalings[2, :3] = torch.tensor([0.1, 4.0, 0.1])  # half its size away
    context = dataclasses.replace(context, loss_mask=LossMask.of_elements(torch.tensor([False, True, True])))
    features = context.scene.anchors.features
    assert torch.equal(estimate(Idw(neighbors=1), context).features[0], features[1])
    assert torch.equal(estimate(Idw(neighbors=1, metric="mahalanobis"), context).features[0], features[2])


def test_mahalanobis_of_equal_round_anchors_is_euclidean() -> None:
    context = random_context(80, 6)
    context.scene.anchors.scalings[:, :3] = torch.where(context.loss_mask.fully_received[:, None], 0.5, 0.0)
    plain, other = estimate(Idw(), context), estimate(Idw(metric="mahalanobis"), context)
    torch.testing.assert_close(other.features, plain.features, rtol=1e-4, atol=1e-5)


def test_prior_concealer_returns_prior_means_and_a_mask_vote() -> None:
    context = random_context(60, 3)
    lost = ~context.loss_mask.fully_received
    result, vote = estimate(PriorMean(), context), estimate(Idw(), context).mask
    assert torch.equal(result.features[lost], context[Prior].feature.mean[lost])
    assert torch.equal(result.offsets[lost].flatten(1), context[Prior].offset.mean[lost])
    assert torch.equal(result.mask, vote)
    floor = context.scene.anchors.scalings[~lost].amin(dim=0)
    assert torch.equal(result.scalings[lost], context[Prior].scaling.mean[lost].maximum(floor))


@pytest.mark.parametrize("options", [{"neighbors": 0}, {"power": -1.0}, {"metric": "taxi"}])
def test_invalid_settings_are_refused(options: dict) -> None:
    with pytest.raises(InvalidValueError):
        Idw(**options)
