import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from concealment.gaps import CONTEXT_DIM, LAYOUT, changed
from paper.contexts import estimate, random_context
from paper.gnn.lively import lively_network
from splatwire.concealment import create_concealer
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError, UnsupportedVersionError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper import Gnn, GnnSettings, GnnWeights, Kriging
from splatwire.paper.gnn import load_weights, rounded_weights, save_weights, write_section
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.quantise import (
    rounded,
    rounded_constants,
    rounded_parameters,
    short_float,
    short_float_index,
)
from splatwire.paper.gnn.section import read_section
from splatwire.paper.gnn.weights import scene_fingerprint
from splatwire.types import LossMask, Prior, ReceivedScene

pytestmark = pytest.mark.slow

SMALL = GnnSettings(neighbors=6, hidden=16, interpolation="kriging", baseline="interpolation")
FULL = dataclasses.replace(SMALL, scaling_threshold=0.1, offset_threshold=0.1)
PARTS = ("features", "scalings", "offsets", "mask")


def lively(context: ReceivedScene, settings: GnnSettings = SMALL, seed: int = 1) -> GnnWeights:
    network, rng = lively_network(settings, seed)
    with torch.no_grad():
        network.get_buffer("query_mean").copy_(torch.randn(len(network.get_buffer("query_mean")), generator=rng))
    return GnnWeights(network.requires_grad_(False), scene_fingerprint(context), {})


def carrying(context: ReceivedScene, section: bytes) -> ReceivedScene:
    return dataclasses.replace(context, sections={"gnn": section, "other": b"unknown"})


@pytest.mark.parametrize("settings", [SMALL, FULL])
@pytest.mark.parametrize("bits", [2, 4, 6])
def test_weights_section_and_weights_file_give_equal_results(settings: GnnSettings, bits: int, tmp_path: Path) -> None:
    context = random_context(150, 2)
    sent = write_section(lively(context, settings), bits)
    save_weights(rounded_weights(lively(context, settings), context, bits), tmp_path / "w")
    from_stream = estimate(Gnn(), carrying(context, sent))
    from_file = estimate(create_concealer(f"gnn:{tmp_path / 'w'}"), context)
    assert all(torch.equal(getattr(from_stream, part), getattr(from_file, part)) for part in PARTS)
    assert load_weights(tmp_path / "w").settings == settings
    assert not torch.equal(from_stream.features, estimate(Kriging(), context).features)


def test_more_bits_give_more_bytes_and_less_error() -> None:
    context = random_context(150, 3)
    exact = estimate(Gnn(lively(context)), context).features
    sizes, errors = [], []
    for bits in (2, 3, 4, 5, 6):
        section = write_section(lively(context), bits)
        sizes.append(len(section))
        errors.append(float((estimate(Gnn(), carrying(context, section)).features - exact).abs().mean()))
    assert sizes == sorted(sizes)
    assert errors[0] > 4 * errors[-1]
    weights = sum(p.numel() for n, p in lively(context).network.named_parameters() if p.dim() == 2)
    assert sizes[2] < 1.25 * 4 / 8 * weights  # heads of attributes with a threshold above 1 take no bytes


def test_rounded_weights_equal_the_received_ones() -> None:
    context = random_context(60, 4)
    weights = lively(context, FULL)
    mean, spread = (weights.network.get_buffer(f"query_{part}") for part in ("mean", "spread"))
    near = rounded_constants(mean, spread)
    mean.copy_(near[0])
    with rounded_parameters(weights.network, 4):
        here = {name: value.clone() for name, value in weights.network.state_dict().items()}
    there = rounded_weights(weights, context, 4).network.state_dict()
    assert all(torch.equal(here[name], there[name]) for name in there)
    before = lively(context, FULL).network.state_dict()["query.0.weight"]
    assert torch.equal(weights.network.state_dict()["query.0.weight"], before)


def test_gradients_pass_through_rounding() -> None:
    network = InpaintingNetwork(InputSizes(LAYOUT, CONTEXT_DIM), SMALL)
    exact = network.query[0].weight.detach().clone()
    with rounded_parameters(network, 3):
        assert not torch.equal(network.query[0].weight, exact)
        network.query[0].weight.square().sum().backward()
    assert torch.equal(network.query[0].weight, exact)
    torch.testing.assert_close(network.query[0].weight.grad, 2 * rounded(exact, 3))


def test_short_floats_are_exact_and_near() -> None:
    values = np.exp(np.random.default_rng(0).normal(size=2000) * 5)
    near = short_float(short_float_index(values))
    assert np.abs(near / values - 1).max() <= 1 / 15
    assert (near == near.astype(np.float32)).all()
    index = np.arange(-100, 100)
    assert (short_float_index(short_float(index)) == index).all()


def test_weights_outside_the_coded_range_are_refused() -> None:
    context = random_context(60, 5)
    never = dataclasses.replace(SMALL, feature_threshold=1.01)
    with pytest.raises(InvalidValueError, match="not worth a byte"):
        write_section(lively(context, never), 4)
    for bits in (1, 7):
        with pytest.raises(InvalidValueError, match="from 2 to 6"):
            write_section(lively(context), bits)
    with pytest.raises(InvalidValueError, match="at most"):
        write_section(lively(context, dataclasses.replace(SMALL, layers=9)), 4)
    for name in ("query.0.weight", "query.0.bias"):
        broken = lively(context)
        broken.network.state_dict()[name].fill_(float("nan"))
        with pytest.raises(InvalidValueError, match="not finite"):
            write_section(broken, 4)


def test_weights_of_another_scene_or_version_are_refused() -> None:
    context = random_context(60, 6)
    section = write_section(lively(context), 4)
    with pytest.raises(InvalidValueError, match="another scene"):
        Gnn()(carrying(random_context(60, 7), section))
    other_layout = context.with_records(dataclasses.replace(LAYOUT, feature_groups=(10,)))
    with pytest.raises(InvalidValueError, match="another scene"):
        Gnn()(carrying(other_layout, section))
    with pytest.raises(UnsupportedVersionError):
        read_section(b"\x01" + section[1:], context)


def test_damaged_weights_are_an_error_or_other_weights_but_never_nan() -> None:
    context = random_context(60, 8)
    section = write_section(lively(context, FULL), 4)
    rng, refused = np.random.default_rng(0), 0
    for trial in range(60):
        damaged = bytearray(section[: rng.integers(len(section)) if trial % 3 == 0 else None])
        for _ in range(3):
            if damaged:
                damaged[rng.integers(len(damaged))] = rng.integers(256)
        try:
            result = context.elements.with_estimates(
                context.loss_mask, estimate(Gnn(), carrying(context, bytes(damaged)))
            )
        except SplatwireError:
            refused += 1
        else:
            assert all(bool(getattr(result, part).isfinite().all()) for part in PARTS[:3])
    assert refused > 20
    with pytest.raises(BitstreamError):
        read_section(section + b"\x00", context)


@pytest.mark.parametrize("known", [0, 1, 3, 12, 150])
def test_few_received_anchors_and_no_losses_are_handled(known: int) -> None:
    """1 of 150 is 99 % loss; 3 are fewer than k; without any the prior remains."""
    context = random_context(150, 9, loss=0)
    rows = torch.arange(150) < known
    a, keep = context.scene.anchors, rows[:, None]
    anchors = dataclasses.replace(
        a,
        features=a.features * keep,
        scalings=a.scalings * keep,
        offsets=a.offsets * keep[:, :, None],
        mask=a.mask & keep,
    )  # fmt: skip
    context = changed(context, anchors=anchors, loss_mask=to_tensors(LossMask.of_elements(rows)))
    section = write_section(lively(context, FULL), 4)
    result = context.elements.with_estimates(context.loss_mask, estimate(Gnn(), carrying(context, section)))
    assert all(bool(getattr(result, part).isfinite().all()) for part in PARTS[:3])
    assert torch.equal(result.features[rows], a.features[rows])
    if known == 0:
        assert torch.equal(result.features, context[Prior].feature.mean)
