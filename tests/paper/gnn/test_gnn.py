import dataclasses
from pathlib import Path

import pytest
import torch

from concealment.gaps import CONTEXT_DIM, LAYOUT, only, permuted
from paper.contexts import estimate, random_context
from paper.gnn.lively import SMALL, lively_network
from reference.mahalanobis import plain_nearest
from splatwire.concealment import concealer_names, create_concealer
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper import Cari, Gnn, GnnSettings, GnnWeights, Idw, PriorMean
from splatwire.paper.gnn import GNN_PRESETS, load_weights, save_weights
from splatwire.paper.gnn.fusion import branches, fuse
from splatwire.paper.gnn.graph import attribute_columns, build_graph, prior_rows, query_inputs, source_inputs
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes, RawResiduals, strongest_edge
from splatwire.paper.gnn.weights import scene_fingerprint
from splatwire.types import Prior, ReceivedScene

PARTS = ("features", "scalings", "offsets", "mask")


def lively(context: ReceivedScene, settings: GnnSettings = SMALL, seed: int = 1) -> GnnWeights:
    return GnnWeights(lively_network(settings, seed)[0], scene_fingerprint(context), {})


def test_factored_edge_convolution_equals_the_plain_one() -> None:
    rng = torch.Generator().manual_seed(0)
    own, others = torch.randn(30, 8, generator=rng), torch.randn(50, 8, generator=rng)
    index = torch.randint(0, 50, (30, 5), generator=rng)
    center, edge, bias = (torch.randn(*s, generator=rng) for s in ((16, 8), (16, 8), (16,)))
    found = strongest_edge(own @ (center - edge).T + bias, others @ edge.T, index)
    for q in range(30):
        messages = []
        for k in index[q].tolist():
            pair = torch.cat([own[q], others[k] - own[q]])
            messages.append(torch.nn.functional.leaky_relu(torch.cat([center, edge], dim=1) @ pair + bias, 0.2))
        plain = torch.stack(messages).amax(dim=0)
        torch.testing.assert_close(found[q], plain, rtol=1e-4, atol=1e-5)


def test_paper_preset_follows_the_paper() -> None:
    paper = GNN_PRESETS["paper"]
    assert (paper.neighbors, paper.hidden, paper.layers, paper.heads) == (24, 128, 2, 4)
    assert (paper.clip, paper.sharpness, paper.baseline) == (3.0, 0.5, "prior")
    assert (paper.feature_threshold, paper.scaling_threshold, paper.offset_threshold) == (0.10, 1.01, 1.01)


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["cari", "idw"])
@pytest.mark.parametrize("separated", [False, True])
def test_thresholds_above_one_give_the_interpolation(interpolation: str, separated: bool) -> None:
    context = random_context(150, 2, separated=separated)
    never = dataclasses.replace(SMALL, interpolation=interpolation, feature_threshold=1.01)
    result = estimate(Gnn(lively(context, never)), context)
    other = Cari() if interpolation == "cari" else Idw(neighbors=6, metric="mahalanobis")
    expected = estimate(other, context)
    assert all(torch.equal(getattr(result, part), getattr(expected, part)) for part in PARTS)


def test_by_default_only_features_differ_from_the_interpolation() -> None:
    context = random_context(150, 3)
    lost = ~context.loss_mask.fully_received
    result, expected = estimate(Gnn(lively(context)), context), estimate(Cari(), context)
    assert (result.features != expected.features)[lost].float().mean() > 0.9
    assert all(torch.equal(getattr(result, part), getattr(expected, part)) for part in PARTS[1:])


def test_gate_blend_and_fallback_follow_the_equations() -> None:
    context = random_context(80, 4)
    graph = build_graph(context, SMALL)
    rng, count = torch.Generator().manual_seed(3), len(graph.queries)
    raw = RawResiduals(*(2 * torch.randn(count, d, generator=rng) for d in (10, 6, 12, 4)))
    prior = prior_rows(context[Prior], graph.queries)
    threshold = 0.45
    settings = dataclasses.replace(SMALL, feature_threshold=threshold)
    result = fuse(branches(raw, prior, graph.interpolated, settings), graph.interpolated, settings)
    taken = 0
    for q in range(count):
        sigma, mu = prior.feature.scale[q].double(), prior.feature.mean[q].double()
        delta = (raw.feature[q].double() * sigma).maximum(-3 * sigma).minimum(3 * sigma)
        c = torch.exp(-0.5 * (delta / (sigma + 1e-6)).abs().mean())
        old = graph.interpolated.features[q].double()
        wanted = c * (mu + c * delta) + (1 - c) * old if c >= threshold else old
        taken += bool(c >= threshold)
        torch.testing.assert_close(result.features[q].double(), wanted, rtol=1e-4, atol=1e-5)
    assert 0 < taken < count


def test_feature_fallback_of_the_paper_is_never_used() -> None:
    """Residuals are clipped at 3 standard deviations, so confidence is at least exp(-0.5 * 3) = 0.22, above 0.10."""
    context, paper = random_context(80, 4), GNN_PRESETS["paper"]
    graph = build_graph(context, SMALL)
    rng, count = torch.Generator().manual_seed(3), len(graph.queries)
    raw = RawResiduals(*(1e6 * torch.randn(count, d, generator=rng) for d in (10, 6, 12, 4)))
    parts = branches(raw, prior_rows(context[Prior], graph.queries), graph.interpolated, paper)
    assert float(parts.feature.confidence.min()) > paper.feature_threshold
    without = dataclasses.replace(paper, feature_threshold=0.0)
    with_fallback, always = (fuse(parts, graph.interpolated, settings) for settings in (paper, without))
    assert torch.equal(with_fallback.features, always.features)


def test_full_attributes_follow_the_mask_head_and_stay_in_range() -> None:
    context = random_context(150, 5)
    settings = dataclasses.replace(SMALL, scaling_threshold=0.0, offset_threshold=0.0)
    result = context.elements.with_estimates(context.loss_mask, estimate(Gnn(lively(context, settings)), context))
    lost = ~context.loss_mask.fully_received
    assert bool((result.offsets[~result.mask] == 0).all())
    assert bool((result.scalings[lost] >= context.scene.anchors.scalings[~lost].amin(dim=0)).all())
    assert not torch.equal(result.mask, estimate(Cari(), context).mask)


def test_network_inputs_follow_the_paper() -> None:
    context = random_context(60, 6)
    graph, sizes = build_graph(context, SMALL), InputSizes(LAYOUT, CONTEXT_DIM)
    known = context.loss_mask.fully_received.nonzero()[:, 0]
    assert source_inputs(context, known).shape == (len(known), sizes.source)
    inputs = query_inputs(context, graph)
    assert inputs.shape == (len(graph.queries), sizes.query)
    start = 3 + CONTEXT_DIM
    assert torch.equal(inputs[:, start : start + 10], context[Prior].feature.mean[graph.queries])
    assert not inputs[:, start + 28 : start + 32].any()  # the mask of a query
    assert bool(context.loss_mask.fully_received[graph.index].all())


def test_paper_preset_queries_use_idw_and_fall_back_to_cari() -> None:
    context, paper = random_context(120, 6), GNN_PRESETS["paper"]
    graph = build_graph(context, paper)
    idw = estimate(Idw(neighbors=24, metric="mahalanobis"), context).select(graph.queries)
    cari = estimate(Cari(), context).select(graph.queries)
    assert torch.equal(attribute_columns(graph.given), attribute_columns(idw))
    assert torch.equal(attribute_columns(graph.interpolated), attribute_columns(cari))
    assert torch.equal(query_inputs(context, graph)[:, 3 + CONTEXT_DIM + 32 :][:, :10], idw.features)
    one = build_graph(context, dataclasses.replace(paper, query_input="interpolation"))
    assert torch.equal(one.given.features, cari.features)
    assert not torch.equal(idw.features, cari.features)


def test_graph_connects_the_24_nearest_received_anchors_by_mahalanobis() -> None:
    context = random_context(200, 7)
    graph = build_graph(context, GNN_PRESETS["paper"])
    known = context.loss_mask.fully_received.nonzero()[:, 0]
    sizes = context.scene.anchors.scalings[known, :3]
    nearest, _ = plain_nearest(context.positions[known], sizes, context.positions[graph.queries], 24)
    assert torch.equal(graph.index, known[nearest])


def test_untrained_network_returns_the_prior_mean() -> None:
    """A zero residual means a confidence of 1, so preset `paper` ignores the interpolation."""
    context = random_context(120, 13)
    for baseline in ("prior", "interpolation"):
        settings = dataclasses.replace(SMALL, baseline=baseline)
        untrained = InpaintingNetwork(InputSizes(LAYOUT, CONTEXT_DIM), settings).eval()
        result = estimate(Gnn(GnnWeights(untrained, scene_fingerprint(context), {})), context)
        expected = context[Prior].feature.mean if baseline == "prior" else estimate(Cari(), context).features
        lost = ~context.loss_mask.fully_received
        assert torch.equal(result.features[lost], expected[lost])


def test_result_is_invariant_to_order_and_chunk_size(monkeypatch: pytest.MonkeyPatch) -> None:
    context = random_context(120, 7)
    weights = lively(context)
    whole = estimate(Gnn(weights), context).features
    monkeypatch.setattr("splatwire.paper.gnn.concealer._CHUNK", 7)
    monkeypatch.setattr("splatwire.paper.gnn.concealer._SOURCE_CHUNK", 11)
    torch.testing.assert_close(estimate(Gnn(weights), context).features, whole, rtol=1e-4, atol=1e-5)
    order = torch.randperm(120, generator=torch.Generator().manual_seed(1))
    shuffled = permuted(context, order)
    other = dataclasses.replace(weights, fingerprint=scene_fingerprint(shuffled))
    torch.testing.assert_close(estimate(Gnn(other), shuffled).features, whole[order], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("received", [0, 1, 3, 100])
def test_very_few_received_anchors_are_enough(received: int) -> None:
    whole = random_context(100, 8, loss=0)
    context = to_tensors(only(whole, torch.arange(100) < received))
    result = context.elements.with_estimates(context.loss_mask, estimate(Gnn(lively(context)), context))
    assert all(bool(getattr(result, part).isfinite().all()) for part in PARTS[:3])
    if received == 0:
        assert torch.equal(result.features, estimate(PriorMean(), context).features)
    if received == 100:
        assert torch.equal(result.features, whole.elements.features)


def test_values_that_are_not_finite_are_never_used() -> None:
    context = random_context(100, 9)
    weights = lively(context)
    with torch.no_grad():
        weights.network.regressors[0][3].bias.fill_(float("nan"))
    assert torch.equal(estimate(Gnn(weights), context).features, estimate(Cari(), context).features)


def test_weights_round_trip_through_a_file(tmp_path: Path) -> None:
    context = random_context(100, 10)
    weights = lively(context)
    save_weights(dataclasses.replace(weights, validation={"gain": 0.5}), tmp_path / "w.safetensors")
    loaded = load_weights(tmp_path / "w.safetensors")
    assert loaded.settings == SMALL
    assert loaded.validation == {"gain": 0.5}
    expected = estimate(Gnn(weights), context).features
    from_file = estimate(create_concealer(f"gnn:{tmp_path / 'w.safetensors'}"), context)
    assert torch.equal(from_file.features, expected)
    save_weights(weights, tmp_path / "half", precision="float16")
    assert (tmp_path / "half").stat().st_size < 0.65 * (tmp_path / "w.safetensors").stat().st_size
    torch.testing.assert_close(estimate(Gnn(tmp_path / "half"), context).features, expected, rtol=0.05, atol=0.05)


def test_invalid_weights_are_refused(tmp_path: Path) -> None:
    context, path = random_context(100, 11), tmp_path / "w"
    with pytest.raises(BitstreamError, match="no such file"):
        load_weights(path)
    path.write_bytes(b"not weights at all")
    with pytest.raises(BitstreamError, match="not a file of"):
        load_weights(path)
    weights = lively(context)
    with torch.no_grad():
        weights.network.regressors[0][3].bias.fill_(float("nan"))
    save_weights(weights, path)
    with pytest.raises(BitstreamError, match="not finite"):
        load_weights(path)
    with pytest.raises(InvalidValueError, match="another scene"):
        Gnn(lively(random_context(100, 12)))(context)
    narrow = GnnWeights(InpaintingNetwork(InputSizes(LAYOUT, 5), SMALL), scene_fingerprint(context), {})
    with pytest.raises(InvalidValueError, match="5 hash features"):
        Gnn(narrow)(context)


def test_gnn_without_weights_is_not_listed() -> None:
    assert "gnn" not in concealer_names()
    assert "gnn" not in concealer_names(("hints",))
    assert "gnn" in concealer_names(("gnn",))
    with pytest.raises(InvalidValueError, match="carries none"):
        create_concealer("gnn")(random_context(50, 1))


@pytest.mark.parametrize(
    "options",
    [
        {"neighbors": 0},
        {"hidden": 10},
        {"heads": 0},
        {"clip": -1.0},
        {"baseline": "x"},
        {"metric": "x"},
        {"query_input": "x"},
    ],
)
def test_invalid_settings_are_refused(options: dict) -> None:
    with pytest.raises(InvalidValueError):
        GnnSettings(**options)


def test_deprecated_name_of_weights_in_use_warns_and_gives_the_new_value() -> None:
    with pytest.warns(DeprecationWarning, match="use is_used"):
        assert lively(random_context(20, 2)).improves
