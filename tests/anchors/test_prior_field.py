import os
from pathlib import Path

import numpy as np
import pytest
import torch

from reference.float_prior import channel_parameters, evaluate_prior, interpolate_hash_grid
from splatwire.neural.model.prior_field import split_prior_outputs
from splatwire.neural.model.tensors import run_network
from splatwire.types import HacppConfig, HacppContextModel, HashGrid, Linear, Mlp

DATA = Path(os.environ.get("SPLATWIRE_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
CONFIG = HacppConfig()


def official_mlp(decoded, prefix: str, slope: float = 0.0) -> Mlp:
    first, second = (
        Linear(*(torch.from_numpy(decoded[f"{prefix}.{i}.{part}"]) for part in ("weight", "bias"))) for i in (0, 2)
    )
    return Mlp(first, second, slope)


@pytest.fixture(scope="module")
def official():
    """Intermediate values of the official code for 3000 anchors, and the model that gave them."""
    folder = DATA / "hacpp" / "snowmiku_small_2400"
    if not (folder / "trace.npz").exists():
        pytest.skip(f"no official trace under {folder} (set SPLATWIRE_DATA)")
    decoded, trace = np.load(folder / "decoded.npz"), np.load(folder / "trace.npz")
    grid = HashGrid(
        torch.from_numpy(decoded["hash_xyz"]),
        torch.stack([torch.from_numpy(decoded[f"hash_{plane}"]) for plane in ("xy", "xz", "yz")]),
        torch.from_numpy(decoded["x_bound_min"][0]),
        torch.from_numpy(decoded["x_bound_max"][0]),
    )
    channel = tuple(official_mlp(decoded, f"mlp_deform.MLP_d{i}", 0.01) for i in range(5))
    context = HacppContextModel(grid, official_mlp(decoded, "mlp_grid"), channel)
    # The official positions are a product of two float32; the trace depends on the last bit.
    positions = torch.from_numpy(decoded["anchor_int"][:3000].astype(np.float32)) * float(decoded["voxel_size"])
    return context, positions, {k: torch.from_numpy(v) for k, v in trace.items() if k.startswith("b0_")}


@pytest.mark.data
def test_context_model_reproduces_the_official_trace(official):
    context, positions, trace = official
    feature = interpolate_hash_grid(context.grid, positions, CONFIG.grid)
    torch.testing.assert_close(feature, trace["b0_interp_feat"], atol=1e-6, rtol=0)
    outputs = run_network(context.prior, feature)
    torch.testing.assert_close(outputs, trace["b0_grid_mlp_out"], atol=2e-6, rtol=1e-6)
    prior = evaluate_prior(context, positions, CONFIG)
    torch.testing.assert_close(prior.feature.step, trace["b0_Q_feat"], atol=1e-6, rtol=0)
    torch.testing.assert_close(prior.scaling.step, trace["b0_Q_scaling"], atol=1e-9, rtol=0)
    torch.testing.assert_close(prior.offset.step, trace["b0_Q_offsets"], atol=1e-6, rtol=0)


@pytest.mark.data
def test_channel_context_reproduces_the_official_trace(official):
    context, _, trace = official
    outputs = split_prior_outputs(trace["b0_grid_mlp_out"], CONFIG)
    decoded = trace["b0_feat_int"] * trace["b0_Q_feat"]
    groups = [channel_parameters(context, g, decoded[:, : 10 * g], outputs) for g in range(5)]
    for ours, theirs in (("mean", "b0_mean_adj"), ("weight", "b0_prob_adj")):
        value = torch.cat([getattr(group, ours) for group in groups], dim=1)
        torch.testing.assert_close(value, trace[theirs], atol=5e-6, rtol=1e-6)
    scale = torch.cat([group.scale for group in groups], dim=1)
    torch.testing.assert_close(scale, trace["b0_scale_adj"].clamp(min=1e-9), atol=5e-6, rtol=1e-6)


def test_outputs_are_split_in_the_official_order():
    outputs = torch.arange(225.0)[None]
    split = split_prior_outputs(outputs, CONFIG)
    starts = [getattr(split, name)[0, 0].item() for name in split.__dataclass_fields__]
    assert starts == [0, 50, 100, 150, 156, 162, 192, 222]
    assert split.step_logits.tolist() == [[222.0, 223.0, 224.0]]


def test_scales_are_positive_and_steps_stay_in_their_range():
    generator = torch.Generator().manual_seed(0)

    def linear(rows: int, columns: int) -> Linear:
        return Linear(torch.randn(rows, columns, generator=generator), torch.randn(rows, generator=generator))

    signs = torch.randint(0, 2, (sum(CONFIG.grid.rows(3)), 4), generator=generator, dtype=torch.int8) * 2 - 1
    planes = torch.randint(0, 2, (3, sum(CONFIG.grid.rows(2)), 4), generator=generator, dtype=torch.int8) * 2 - 1
    grid = HashGrid(signs, planes, torch.zeros(3), torch.ones(3))
    context = HacppContextModel(grid, Mlp(linear(100, 96), linear(225, 100)), ())
    prior = evaluate_prior(context, torch.rand(40000, 3, generator=generator), CONFIG)
    assert prior.context_features.shape == (40000, 96)
    for attribute, base in ((prior.feature, 1.0), (prior.scaling, 0.001), (prior.offset, 0.2)):
        assert attribute.scale.min() >= 1e-9
        assert attribute.step.min() >= 0
        assert attribute.step.max() <= 2 * base
    whole = run_network(context.prior, prior.context_features)
    torch.testing.assert_close(prior.scaling.mean, whole[:, 150:156])


def test_channel_context_refuses_the_wrong_number_of_decoded_channels():
    network = Mlp(Linear(torch.zeros(4, 160), torch.zeros(4)), Linear(torch.zeros(30, 4), torch.zeros(30)), 0.01)
    signs = torch.ones(8, 4, dtype=torch.int8)
    grid = HashGrid(signs, signs.expand(3, -1, -1), torch.zeros(3), torch.ones(3))
    context = HacppContextModel(grid, network, (network, network))
    outputs = split_prior_outputs(torch.zeros(2, 225), CONFIG)
    with pytest.raises(ValueError, match="group 1 follows 10 channels, not 9"):
        channel_parameters(context, 1, torch.zeros(2, 9), outputs)
