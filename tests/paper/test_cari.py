import dataclasses

import numpy as np
import pytest
import torch

from concealment.gaps import LAYOUT, changed, permuted
from paper.cari_reference import cari as cari_reference
from paper.contexts import estimate, random_context
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.ops.knn import nearest_neighbors
from splatwire.paper import CARI_PRESETS, Cari, MaskVote
from splatwire.paper.signature import residuals_of, signatures, uncertainties, unit_rows
from splatwire.paper.weighting import ScoreExponents, Support, select_neighbors
from splatwire.types import Prior

ATTRIBUTES = ("features", "scalings", "offsets")


def test_the_paper_preset_holds_the_papers_constants() -> None:
    paper = CARI_PRESETS["paper"]
    assert paper == Cari()
    assert (paper.candidates, paper.neighbors, paper.passes, paper.ridge) == (128, 8, 2, None)
    assert (paper.distance_exponent, paper.context_exponent) == (1.0, 2.0)
    assert (paper.uncertainty_exponent, paper.signature_exponent) == (1.0, 1.5)
    assert paper.recovered_confidence == 0.5


@pytest.mark.parametrize("separated", [False, True])
@pytest.mark.parametrize("passes", [1, 2, 3])
@pytest.mark.parametrize(("num_anchors", "candidates", "neighbors"), [(40, 12, 4), (25, 128, 8), (9, 3, 5)])
def test_cari_equals_loops_over_the_equations(
    num_anchors: int, candidates: int, neighbors: int, passes: int, separated: bool
) -> None:
    for seed in range(3):
        context = random_context(num_anchors, seed, separated=separated)
        result = estimate(Cari(candidates=candidates, neighbors=neighbors, passes=passes), context)
        result = context.elements.with_estimates(context.loss_mask, result)
        *wanted, mask = cari_reference(context, candidates, neighbors, passes, eps=1e-6)
        for name, values in zip(ATTRIBUTES, wanted, strict=True):
            got = getattr(result, name).flatten(1).numpy()
            np.testing.assert_allclose(got, values, rtol=1e-5, atol=1e-5, err_msg=f"{name}, seed {seed}")
        np.testing.assert_array_equal(result.mask.numpy(), mask)


def test_compiled_scores_equal_the_plain_version() -> None:
    context = random_context(600, 3)
    known = context.loss_mask.fully_received
    support = Support(
        unit_rows(context[Prior].context_features),
        unit_rows(signatures(residuals_of(context))),
        1 / uncertainties(context[Prior], LAYOUT),
    )
    support.signature[~known] = unit_rows(torch.randn(int((~known).sum()), 7))
    queries = (~known).nonzero()[:, 0]
    index, distance = nearest_neighbors(
        context.scene.anchors.positions[known], context.scene.anchors.positions[queries], 50
    )
    candidates, distance = known.nonzero()[:, 0][index], torch.from_numpy(distance)
    for exponents in (ScoreExponents(1.0, 2.0, 1.5, 1e-6), ScoreExponents(0.7, 1.3, 0.0, 1e-6)):
        arguments = (support, queries, candidates, distance, 8, exponents)
        fast, plain = select_neighbors(*arguments), select_neighbors(*arguments, backend="torch")
        torch.testing.assert_close(fast.weight, plain.weight, rtol=1e-4, atol=1e-6)
        assert (fast.index == plain.index).float().mean() > 0.999  # scores that differ by rounding only may swap
        assert bool((fast.weight >= 0).all())
        torch.testing.assert_close(fast.weight.sum(dim=2), torch.ones(len(queries), 8), rtol=0, atol=1e-4)
        assert bool((fast.weight[:, :, :-1] >= fast.weight[:, :, 1:]).all())


def test_backends_give_equal_results() -> None:
    context = random_context(300, 5)
    fast, plain = estimate(Cari(), context), estimate(Cari(backend="torch"), context)
    for name in ATTRIBUTES:
        torch.testing.assert_close(getattr(fast, name), getattr(plain, name), rtol=1e-4, atol=1e-4)
    assert torch.equal(fast.mask, plain.mask)


def test_equal_residuals_are_restored_exactly() -> None:
    context = random_context(200, 7)
    anchors, prior, known = context.scene.anchors, context[Prior], context.loss_mask.fully_received
    mask = torch.tensor([True, False, True, True]).expand(200, 4)
    truth = dataclasses.replace(
        anchors,
        features=prior.feature.mean + 0.25,
        scalings=prior.scaling.mean + 0.125,
        offsets=(prior.offset.mean.view(200, 4, 3) - 0.5) * mask[:, :, None],
        mask=mask,
    )
    received = dataclasses.replace(
        truth,
        features=truth.features * known[:, None],
        scalings=truth.scalings * known[:, None],
        offsets=truth.offsets * known[:, None, None],
        mask=mask & known[:, None],
    )
    result = estimate(Cari(), changed(context, anchors=received))
    torch.testing.assert_close(result.features, truth.features, rtol=0, atol=1e-5)
    floor = truth.scalings[known].amin(dim=0)
    torch.testing.assert_close(result.scalings, truth.scalings.maximum(floor), rtol=0, atol=1e-5)
    torch.testing.assert_close(result.offsets * mask[:, :, None], truth.offsets, rtol=0, atol=1e-5)
    assert torch.equal(result.mask, mask)


def test_dissimilar_context_gets_no_weight() -> None:
    """Of two equidistant neighbours, the one with the opposite hash context has weight 0."""
    context = random_context(3, 1)
    context.scene.anchors.positions.copy_(torch.tensor([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0]]))
    known = torch.tensor([False, True, True])
    hashes = torch.stack([torch.ones(12), torch.ones(12), -torch.ones(12)])
    prior = dataclasses.replace(context[Prior], context_features=hashes)
    anchors = dataclasses.replace(context.scene.anchors, features=torch.randn(3, 10) * known[:, None])
    loss_mask = to_tensors(type(context.loss_mask).of_elements(known))
    result = estimate(Cari(passes=1), changed(context, prior=prior, anchors=anchors, loss_mask=loss_mask))
    wanted = prior.feature.mean[0] + anchors.features[1] - prior.feature.mean[1]
    torch.testing.assert_close(result.features[0], wanted, rtol=0, atol=1e-4)


def test_permuting_the_anchors_permutes_the_result() -> None:
    context = random_context(150, 11)
    order = torch.randperm(150, generator=torch.Generator().manual_seed(0))
    straight, mixed = estimate(Cari(), context).select(order), estimate(Cari(), permuted(context, order))
    for name in ATTRIBUTES:
        torch.testing.assert_close(getattr(mixed, name), getattr(straight, name), rtol=1e-5, atol=1e-5)
    assert torch.equal(mixed.mask, straight.mask)


def test_ridge_regression_follows_a_linear_gradient() -> None:
    context = random_context(400, 2)
    slope = torch.tensor([[0.5] * 10, [-1.0] * 10, [0.25] * 10])
    truth = context[Prior].feature.mean + context.scene.anchors.positions @ slope
    known = context.loss_mask.fully_received
    anchors = dataclasses.replace(context.scene.anchors, features=truth * known[:, None])
    context = changed(context, anchors=anchors)
    errors = [
        (estimate(Cari(ridge=ridge, passes=1), context).features - truth)[~known].square().mean()
        for ridge in (None, 0.1)
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize(
    "options",
    [
        {"neighbors": 0},
        {"candidates": 0},
        {"passes": 0},
        {"epsilon": 0.0},
        {"context_exponent": -1.0},
        {"distance_exponent": float("nan")},
        {"ridge": 0.0},
        {"backend": "cuda"},
    ],
)
def test_invalid_settings_are_refused(options: dict) -> None:
    with pytest.raises(InvalidValueError):
        Cari(**options)


def test_mask_vote_keeps_the_offset_count_of_neighbours() -> None:
    share = torch.tensor([[0.4, 0.1, 0.4, 0.1], [0.9, 0.9, 0.9, 0.4], [0.1, 0.1, 0.1, 0.0]])
    supported = torch.ones(3, dtype=torch.bool)
    count = MaskVote("count")(share, supported)
    assert count.tolist() == [[True, False, False, False], [True, True, True, False], [False] * 4]
    assert MaskVote()(share, supported).tolist() == [[False] * 4, [True, True, True, False], [False] * 4]
    assert bool(MaskVote("all")(share, supported).all())
    assert bool(MaskVote()(share, ~supported).all())
