import dataclasses

import pytest
import torch

from concealment.gaps import changed, only
from paper.contexts import estimate, random_context
from splatwire.errors import InvalidValueError
from splatwire.paper import Idw, Kriging, PriorMean
from splatwire.paper.kriging import TARGETS, Correlogram, kriging_weights, regress
from splatwire.types import Prior


def _field_of(positions: torch.Tensor, correlation: float, length: float, channels: int) -> torch.Tensor:
    """Random field with the covariance of the kriging model, from a Cholesky factor in float64."""
    between = torch.cdist(positions.double(), positions.double())
    covariance = correlation * torch.exp(-between / length)
    covariance.fill_diagonal_(1.0)
    noise = torch.randn(len(positions), channels, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    return (torch.linalg.cholesky(covariance) @ noise).float()


def test_weights_are_the_conditional_mean_of_a_joint_normal() -> None:
    rng = torch.Generator().manual_seed(0)
    positions = torch.randn(40, 3, generator=rng)
    queries, index = torch.arange(5), torch.stack([5 + torch.randperm(35, generator=rng)[:6] for _ in range(5)])
    distance = (positions[queries, None] - positions[index]).norm(dim=2)
    distance, order = distance.sort(dim=1)
    index = index.gather(1, order)
    fit = Correlogram(0.7, 1.3)
    weight = kriging_weights(positions, index, distance, fit)
    for q in range(5):
        points = torch.cat([positions[q][None], positions[index[q]]]).double()
        joint = 0.7 * torch.exp(-torch.cdist(points, points) / (1.3 * float(distance[q, -1])))
        joint.fill_diagonal_(1.0)
        precision = torch.linalg.inv(joint)  # the conditional mean from the precision matrix
        torch.testing.assert_close(weight[q].double(), -precision[0, 1:] / precision[0, 0], rtol=1e-4, atol=1e-5)


def test_kriging_beats_mean_and_idw_on_a_gaussian_field() -> None:
    context = random_context(500, 1)
    lost = ~context.loss_mask.fully_received
    truth = _field_of(context.scene.anchors.positions, 0.8, 1.0, 10)
    anchors = dataclasses.replace(context.scene.anchors, features=truth * ~lost[:, None])
    context = changed(context, anchors=anchors)

    def error(features: torch.Tensor) -> float:
        return float(((features - truth)[lost] ** 2).mean())

    positions = context.scene.anchors.positions.double()
    covariance = 0.8 * torch.exp(-torch.cdist(positions, positions))
    covariance.fill_diagonal_(1.0)
    best = covariance[lost][:, ~lost] @ torch.linalg.solve(covariance[~lost][:, ~lost], truth[~lost].double())
    best_error = float(((best - truth[lost]) ** 2).mean())  # all neighbours, the true covariance
    kriged = error(estimate(Kriging(target="absolute"), context).features)
    assert best_error < kriged < 1.05 * best_error
    assert kriged < error(estimate(Idw(), context).features)


def test_uninformative_neighbours_give_the_mean() -> None:
    context = random_context(400, 2)
    lost = ~context.loss_mask.fully_received
    residual = estimate(Kriging(target="residual"), context)
    spread = context.scene.anchors.features[~lost].std()
    assert float((residual.features - context[Prior].feature.mean)[lost].abs().mean()) < 0.3 * float(spread)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("received", [0, 1, 2])
def test_very_few_received_anchors_are_enough(target: str, received: int) -> None:
    context = only(random_context(20, 3, loss=0), torch.arange(20) < received)
    result = estimate(Kriging(target=target), context)
    for part in (result.features, result.scalings, result.offsets):
        assert bool(part.isfinite().all())
    if received == 0:
        assert torch.equal(result.features, estimate(PriorMean(), context).features)


def test_coincident_anchors_give_finite_values_and_received_values_stay() -> None:
    context = random_context(200, 4, separated=True)
    context.scene.anchors.positions[:100] = context.scene.anchors.positions[0]
    result = estimate(Kriging(), context)
    received = context.loss_mask.received
    assert torch.equal(result.features[received[:, 0]], context.scene.anchors.features[received[:, 0]])
    assert torch.equal(result.scalings[received[:, 1]], context.scene.anchors.scalings[received[:, 1]])
    assert all(bool(part.isfinite().all()) for part in (result.features, result.scalings, result.offsets))


def test_result_does_not_depend_on_the_chunk_size(monkeypatch: pytest.MonkeyPatch) -> None:
    context = random_context(300, 6)
    whole = estimate(Kriging(), context)
    monkeypatch.setattr("splatwire.paper.kriging._CHUNK", 7)
    torch.testing.assert_close(estimate(Kriging(), context).features, whole.features, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("options", [{"neighbors": 0}, {"sample": 0}, {"target": "both"}])
def test_invalid_settings_are_refused(options: dict) -> None:
    with pytest.raises(InvalidValueError):
        Kriging(**options)


def test_regression_equals_least_squares_on_received_values() -> None:
    rng = torch.Generator().manual_seed(4)
    inputs = torch.randn(4000, 7, generator=rng, dtype=torch.float64)
    truth = torch.randn(7, 3, generator=rng, dtype=torch.float64)
    exists = torch.rand(4000, 3, generator=rng) < torch.tensor([0.5, 0.8, 1.0])
    values = (inputs @ truth + 0.1 * torch.randn(4000, 3, generator=rng, dtype=torch.float64)).float() * exists
    fit = regress(inputs, values, exists)
    for column in range(3):
        rows = exists[:, column]
        plain = torch.linalg.lstsq(inputs[rows], values[rows, column].double()).solution
        assert float((fit[:, column] - inputs @ plain).abs().mean()) < 0.02 * float(values[rows, column].std())
    assert bool((regress(inputs, values, torch.zeros_like(exists)) == 0).all())


@pytest.mark.slow
def test_regression_uses_priors_of_other_channels() -> None:
    context = random_context(2000, 6)
    lost = ~context.loss_mask.fully_received
    truth = context[Prior].feature.mean.flip(1) - 0.5 * context[Prior].scaling.mean.sum(dim=1, keepdim=True)
    context = changed(context, features=truth * ~lost[:, None])

    def error(target: str) -> float:
        return float(((estimate(Kriging(target=target), context).features - truth)[lost] ** 2).mean())

    assert error("regression") < 0.02 * min(error("residual"), error("absolute"))
