import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
import torch

from concealment.gaps import changed
from fake_device import DEVICE, fake_device
from paper.contexts import estimate
from paper.smooth_field import smooth_field
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization
from splatwire.calibration.pseudo_loss import calibration_data, pseudo_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper import Cari, Gnn, GnnSettings, GnnWeights, Idw, PriorMean
from splatwire.paper.calibration.calibrate import calibrate
from splatwire.paper.calibration.config import CALIBRATION_PRESETS, CalibrationConfig
from splatwire.paper.calibration.losses import (
    LossWeights,
    channel_spread,
    normalized_errors,
    parameter_losses,
    weighted_sum,
)
from splatwire.paper.calibration.run import CalibrationRun
from splatwire.paper.gnn.fusion import branches
from splatwire.paper.gnn.graph import build_graph, prior_rows
from splatwire.paper.gnn.network import RawResiduals
from splatwire.types import Prior

pytestmark = pytest.mark.slow

SETTINGS = GnnSettings(neighbors=6, hidden=16, baseline="interpolation")
CONFIG = CalibrationConfig(
    SETTINGS, iterations=12, train_masks=2, validation_masks=1, batch=64, validation_interval=4, patience=99
)

FIELD = dataclasses.replace(
    CALIBRATION_PRESETS["paper"],
    settings=dataclasses.replace(CALIBRATION_PRESETS["paper"].settings, hidden=32),
    iterations=120,
    train_masks=6,
    validation_masks=2,
    validation_interval=60,
)
"""The paper's preset, narrow and short."""


@pytest.fixture(scope="module")
def complete():
    stream = encode_scene(tiny_scene(seed=2, num_anchors=400), Packetization(block_size=100))
    return stream, decode_stream(stream)


@pytest.fixture(scope="module")
def data(complete):
    return calibration_data(*complete, tiny_cameras(num_views=2, width=48, height=32))


def test_pseudo_losses_drop_whole_packets(data) -> None:
    known = pseudo_loss(data.members, 400, 0.2, seed=3)
    ranks, starts = data.members
    fates = [known[ranks[a:b]] for a, b in itertools.pairwise(starts)]
    assert all(bool(fate.all()) or not bool(fate.any()) for fate in fates)
    assert sum(not bool(fate.any()) for fate in fates) == round(0.2 * len(fates))
    assert not np.array_equal(known, pseudo_loss(data.members, 400, 0.2, seed=4))
    for rate in (1e-9, 1 - 1e-9):
        assert 0 < int(pseudo_loss(data.members, 400, rate, seed=0).sum()) < 400


def test_network_inputs_do_not_depend_on_lost_values(data) -> None:
    known = pseudo_loss(data.members, 400, 0.3, seed=1)
    received = data.complete.masked(known)
    assert not received.scene.anchors.features[~known].any()
    assert bool(known[build_graph(received, SETTINGS).index].all())


def test_device_run_mixes_no_cpu_tensors(data) -> None:
    with fake_device():
        result = calibrate(data, CONFIG, device=str(DEVICE))
    expected = calibrate(data, CONFIG)
    assert result.iterations == CONFIG.iterations
    for name, value in expected.weights.network.state_dict().items():
        found = result.weights.network.state_dict()[name]
        assert found.device.type == "cpu"
        torch.testing.assert_close(found, value, atol=1e-4, rtol=1e-3)
    assert result.errors == pytest.approx(expected.errors, rel=1e-3)


def test_rendering_loss_requires_the_cpu(data) -> None:
    config = dataclasses.replace(CONFIG, losses=LossWeights(render=0.1))
    with pytest.raises(InvalidValueError, match="rendering loss is computed on the CPU, not on cuda"):
        calibrate(data, config, device="cuda")


def test_calibration_is_repeatable_and_resumable(data, tmp_path: Path) -> None:
    whole = calibrate(data, CONFIG).weights.network.state_dict()
    again = calibrate(data, CONFIG, checkpoint=tmp_path / "c").weights.network.state_dict()
    assert all(torch.equal(whole[name], again[name]) for name in whole)

    class PulledPlugError(Exception):
        """Simulates a power failure."""

    def stop(iteration: int, loss: float) -> None:
        if iteration == 9:
            raise PulledPlugError

    with pytest.raises(PulledPlugError):
        calibrate(data, CONFIG, checkpoint=tmp_path / "d", progress=stop)
    resumed = calibrate(data, CONFIG, checkpoint=tmp_path / "d", resume=True).weights.network.state_dict()
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)
    with pytest.raises(InvalidValueError, match="other settings"):
        calibrate(data, dataclasses.replace(CONFIG, seed=5), checkpoint=tmp_path / "d", resume=True)
    (tmp_path / "d").write_bytes(b"rubbish")
    with pytest.raises(BitstreamError):
        calibrate(data, CONFIG, checkpoint=tmp_path / "d", resume=True)


def test_calibration_lowers_the_error_on_learnable_data(data) -> None:
    """Residuals follow from the hash feature alone, so residuals of neighbours do not predict them."""
    prior = data.complete[Prior]
    residual = 2 * prior.feature.scale * prior.context_features[:, :12]
    anchors = dataclasses.replace(data.complete.scene.anchors, features=prior.feature.mean + residual)
    easy = dataclasses.replace(data, complete=changed(data.complete, anchors=anchors))
    losses = LossWeights(distill=0.0, smooth=0.0, prior=0.0)
    trusting = dataclasses.replace(SETTINGS, sharpness=0.0, baseline="prior")
    config = dataclasses.replace(
        CONFIG,
        settings=trusting,
        losses=losses,
        iterations=120,
        train_masks=12,
        validation_masks=3,
        validation_interval=40,
        learning_rate=0.01,
    )
    result = calibrate(easy, config)
    assert result.errors["feature"] < 0.97 * result.reference["feature"]
    known = pseudo_loss(data.members, 400, 0.2, seed=77)
    received, rows = easy.complete.masked(known), torch.from_numpy(np.flatnonzero(~known))
    truth = to_tensors(anchors)

    def error(concealer) -> float:
        concealed = estimate(concealer, received).select(rows)
        return normalized_errors(concealed, truth, channel_spread(truth), rows)["feature"]

    assert error(Gnn(result.weights)) < error(Cari())


def test_unhelpful_predictions_fall_back_to_interpolation(data) -> None:
    """Independent noise cannot be predicted: the result must equal the interpolation, not be worse."""
    rng = np.random.default_rng(1)
    noise = data.complete[Prior].feature.mean + rng.standard_normal((400, 12)).astype(np.float32)
    anchors = dataclasses.replace(data.complete.scene.anchors, features=noise)
    hard = dataclasses.replace(data, complete=changed(data.complete, anchors=anchors))
    result = calibrate(hard, dataclasses.replace(CONFIG, learning_rate=0.1))
    assert result.errors["feature"] <= result.reference["feature"]


def test_paper_preset_uses_the_papers_schedule_without_selection(data) -> None:
    preset = CALIBRATION_PRESETS["paper"]
    assert (preset.iterations, preset.learning_rate, preset.drop_rate, preset.selected) == (15_000, 1e-3, 0.2, False)
    losses = preset.losses
    assert (losses.distill, losses.smooth, losses.prior, losses.render) == (0.25, 0.05, 0.1, 0.0)
    assert (losses.feature, losses.scaling, losses.offset, losses.mask) == (1.0, 0.0, 0.0, 0.0)
    hopeless = dataclasses.replace(
        CONFIG, settings=preset.settings, learning_rate=1e-9, patience=1, validation_interval=2, selected=False
    )
    result = calibrate(data, hopeless)
    assert result.iterations == hopeless.iterations  # no early stop
    assert result.weights.settings == preset.settings
    assert calibrate(data, dataclasses.replace(hopeless, selected=True)).iterations < hopeless.iterations


def test_network_beats_interpolation_when_the_prior_is_informative() -> None:
    """Features are half a smooth function known to the prior, half a function known to neighbours, and noise."""
    data = smooth_field(1000, noise=0.5, known_to_prior=0.5)
    errors, weights = field_errors(data, FIELD)
    assert errors["gnn"] < min(errors["cari"], errors["idw"], errors["prior"]) - 0.005
    assert weights.settings.feature_threshold == 0.10


def test_paper_rule_is_worse_than_cari_when_the_prior_is_uninformative() -> None:
    """A small residual means full trust in the prior, which is uninformative here; the added rule gives CARI."""
    data = smooth_field(1000, noise=0.05, known_to_prior=0.0)
    alone, _ = field_errors(data, FIELD)
    assert alone["gnn"] > alone["cari"] + 0.05
    selected, weights = field_errors(data, dataclasses.replace(FIELD, selected=True))
    assert selected["gnn"] == selected["cari"]
    assert weights.settings.feature_threshold == 1.01


def field_errors(data, config) -> tuple[dict[str, float], GnnWeights]:
    """Errors of lost features relative to their spread, under a loss that calibration did not use."""
    weights = calibrate(data, config).weights
    known, anchors = data.pseudo_losses([0.2], seed=77)[0], to_tensors(data.scene.anchors)
    received, rows = data.complete.masked(known), torch.from_numpy(np.flatnonzero(~known))
    concealers = {"prior": PriorMean(), "idw": Idw(), "cari": Cari(), "gnn": Gnn(weights)}
    return {
        name: normalized_errors(estimate(c, received).select(rows), anchors, channel_spread(anchors), rows)["feature"]
        for name, c in concealers.items()
    }, weights


def test_rendering_loss_has_gradients_for_the_network(data) -> None:
    losses = LossWeights(feature=1e-30, distill=0.0, smooth=0.0, prior=0.0, render=1.0)
    gradients = []
    for render in (0.0, 1.0):
        config = dataclasses.replace(CONFIG, losses=dataclasses.replace(losses, render=render))
        run = CalibrationRun(data, config)
        run.step()
        gradients.append(float(run.network.regressors[0][3].weight.grad.abs().max()))
    assert gradients[0] < 1e-20 < 1e-9 < gradients[1]
    with pytest.raises(InvalidValueError, match="cameras"):
        calibrate(dataclasses.replace(data, cameras=None), dataclasses.replace(CONFIG, losses=losses))


def test_loss_follows_the_equations(data) -> None:
    known = pseudo_loss(data.members, 400, 0.1, seed=0)
    complete = to_tensors(data.complete)
    graph = build_graph(to_tensors(data.complete.masked(known)), SETTINGS)
    rng, count = torch.Generator().manual_seed(0), len(graph.queries)
    raw = RawResiduals(*(torch.randn(count, d, generator=rng) for d in (12, 6, 12, 4)))
    parts = branches(raw, prior_rows(complete[Prior], graph.queries), graph.interpolated, SETTINGS)
    truth = complete.scene.anchors.select(graph.queries)
    weights = LossWeights(1.0, 1.0, 1.0, 1.0, active_offset=3.0, smooth_neighbors=3, smooth_bandwidth=0.7)
    terms = parameter_losses(parts, truth, truth.positions, weights)
    f, s, o = (branch.predicted.double() for _, branch in parts.continuous())
    wanted = dict.fromkeys(("feature", "scaling", "offset", "mask", "distill", "prior", "smooth"), 0.0)
    gaps = torch.cdist(truth.positions.double(), truth.positions.double())
    near = gaps.fill_diagonal_(float("inf")).topk(3, largest=False)
    width = 0.7 * float(near.values.mean())
    for q in range(count):
        wanted["feature"] += float((f[q] - truth.features[q]).abs().sum())
        wanted["scaling"] += float((s[q] - truth.scalings[q]).abs().sum())
        for c in range(12):
            wrong = float((o[q, c] - truth.offsets[q].flatten()[c]) ** 2 + 1e-6) ** 0.5
            wanted["offset"] += wrong * (3 if truth.mask[q, c // 3] else 1)
        p = torch.sigmoid(parts.mask_logit[q].double())
        wanted["mask"] -= float(torch.where(truth.mask[q], p, 1 - p).log().sum())
        for _, branch in parts.continuous():
            estimate = branch.predicted[q].double()
            wanted["distill"] += float((estimate - branch.interpolated[q]).abs().sum())
            z = (estimate - branch.prior.mean[q]) / (branch.prior.scale[q] + 1e-6)
            wanted["prior"] += float(z.abs().mean())
        for distance, other in zip(near.values[q].tolist(), near.indices[q].tolist(), strict=True):
            omega = float(torch.exp(torch.tensor(-0.5 * (distance / width) ** 2)))
            wanted["smooth"] += omega * float(sum((v[q] - v[other]).abs().sum() for v in (f, s, o))) / (3 * count)
    for name, value in wanted.items():
        assert float(terms[name]) == pytest.approx(value, rel=1e-3), name
    total = sum(getattr(weights, name) * value for name, value in wanted.items())
    assert float(weighted_sum(terms, weights)) == pytest.approx(total, rel=1e-3)


def test_incomplete_scenes_and_invalid_settings_are_refused(complete) -> None:
    stream, _ = complete
    lossy = stream.with_packets(stream.packets[1:])
    with pytest.raises(InvalidValueError, match="complete"):
        calibration_data(lossy, decode_stream(lossy))
    for bad in ({"iterations": 0}, {"drop_rate": 1.0}, {"learning_rate": 0.0}, {"seed": -1}):
        with pytest.raises(InvalidValueError):
            CalibrationConfig(**bad)
    with pytest.raises(InvalidValueError):
        LossWeights(feature=0.0)
