"""Device versions of parts of an iteration against the originals."""

import dataclasses
import math

import pytest
import torch

from scenes import SMALL_CAUSAL, tiny_cameras, tiny_scene
from splatwire.neural.model import gaussian_heads
from splatwire.neural.model.tensors import run_network, to_tensors
from splatwire.neural.training.causal import anchor_and_offset_bits, attribute_steps, value_bits
from splatwire.neural.training.causal_device import POSITION_BITS, _ValueBits, packed_anchor_bits, value_steps
from splatwire.neural.training.device_view import ViewConstants, on_image, spawn_all, visible_anchors
from splatwire.neural.training.growth import on_image as on_image_reference
from splatwire.neural.training.kernels import sample_from_host, sample_on_device
from splatwire.neural.training.packed import pack_networks
from splatwire.neural.training.state import CONTEXT_NEGATIVE_SLOPE
from splatwire.types import Gaussians, Linear, Mlp
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.causal_coding import CausalConfig


def _mlp(inputs: int, hidden: int, outputs: int, rng: torch.Generator) -> Mlp:
    def layer(rows: int, columns: int) -> Linear:
        weight, bias = torch.randn(rows, columns, generator=rng), torch.randn(rows, generator=rng)
        return Linear(weight.requires_grad_(), bias.requires_grad_())

    return Mlp(layer(hidden, inputs), layer(outputs, hidden), CONTEXT_NEGATIVE_SLOPE)


def _gradients(networks: list[Mlp]) -> list[torch.Tensor]:
    layers = [layer for mlp in networks for layer in (mlp.hidden, mlp.output)]
    found = [tensor.grad for layer in layers for tensor in (layer.weight, layer.bias)]
    for layer in layers:
        layer.weight.grad = layer.bias.grad = None
    assert all(gradient is not None for gradient in found)
    return [gradient for gradient in found if gradient is not None]


def test_packed_networks_equal_the_networks() -> None:
    rng = torch.Generator().manual_seed(0)
    networks = [_mlp(3, 8, 4, rng), _mlp(5, 6, 2, rng), _mlp(7, 8, 5, rng)]
    inputs, order = torch.randn(50, 7, generator=rng), tuple(torch.randperm(11, generator=rng).tolist())
    weight = torch.randn(50, 11, generator=rng)
    expected = torch.cat([run_network(mlp, inputs[:, : mlp.hidden.weight.shape[1]]) for mlp in networks], dim=1)[
        :, list(order)
    ]
    (expected * weight).sum().backward()
    gradients = _gradients(networks)
    found = pack_networks(networks, order)(inputs, CONTEXT_NEGATIVE_SLOPE)
    (found * weight).sum().backward()
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(_gradients(networks), gradients, atol=1e-3, rtol=1e-4)


def test_bit_gradient_equals_its_definition() -> None:
    rng = torch.Generator().manual_seed(0)
    values, mean = 3 * torch.randn(400, 10, generator=rng), torch.randn(400, 10, generator=rng)
    log_deviation = 6 * torch.randn(400, 10, generator=rng)  # some out of bounds
    values[:5] += 1000  # below the smallest likelihood
    results = []
    for bits_of in (value_bits, _ValueBits.apply):
        own = [value.clone().double().requires_grad_() for value in (values, mean, log_deviation)]
        found = bits_of(*own)
        (found * torch.linspace(0.5, 2, 4000).view(400, 10)).sum().backward()
        results.append([found.detach(), *(value.grad for value in own)])
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-5)
    single = _ValueBits.apply(values, mean, log_deviation)
    assert bool(torch.isfinite(single).all())


def test_sampled_bits_equal_those_of_separate_networks() -> None:
    config, rng = SMALL_CAUSAL, torch.Generator().manual_seed(0)
    networks = {name: _mlp(inputs, 9, outputs, rng) for name, (inputs, outputs) in config.shapes().items()}
    place = torch.rand(70, config.shapes()["position"][0], generator=rng)
    width = config.layout.feature_dim + 4 + 3 * config.layout.num_offsets
    values = torch.randn(70, width, generator=rng)
    mask = (torch.rand(70, config.layout.num_offsets, generator=rng) < 0.5).float()
    parts = values.split([config.layout.feature_dim, 4, 3 * config.layout.num_offsets], dim=1)
    own, offsets = anchor_and_offset_bits(networks, config, place, parts, mask)
    found = packed_anchor_bits(networks, config, place, values, mask)
    torch.testing.assert_close(found, own + offsets.sum(dim=1) + POSITION_BITS, atol=0.02, rtol=1e-4)


@pytest.mark.parametrize("config", [SMALL_CAUSAL, CausalConfig()])
def test_column_steps_equal_channel_steps(config: CausalConfig) -> None:
    logs = torch.randn(config.num_steps, generator=torch.Generator().manual_seed(0))
    feature, log_scaling, offset = attribute_steps(logs, config)
    found = value_steps(logs, config)
    expected = torch.cat([feature, log_scaling, offset.expand(3 * config.layout.num_offsets)])
    assert torch.equal(found, expected)


@pytest.mark.parametrize("near_depth", [0.05, NEAR_DEPTH, 2.0])
@pytest.mark.parametrize("axes", [1, 3])
def test_visible_anchors_equal_the_plain_projection(axes: int, near_depth: float) -> None:
    scene = tiny_scene(num_anchors=400)
    cameras = dataclasses.replace(tiny_cameras(6, 50, 38), near_depth=near_depth)
    rng = torch.Generator().manual_seed(0)
    positions = 3 * torch.randn(5000, 3, generator=rng)
    sizes = torch.exp(torch.randn(5000, axes, generator=rng) - 3)
    anchors = _anchors(scene, positions, sizes.expand(-1, 3))
    views = ViewConstants.of(to_tensors(cameras))
    for view in range(cameras.num_views):
        expected = gaussian_heads.visible_anchors(anchors, cameras, view)
        found = visible_anchors(views, view, positions, sizes)
        assert 0 < int(expected.sum()) < 5000
        assert int((found != expected).sum()) <= 2  # rounding at the border


def _anchors(scene: object, positions: torch.Tensor, sizes: torch.Tensor) -> object:
    first = to_tensors(scene.anchors).select(torch.zeros(len(positions), dtype=torch.int64))  # type: ignore[attr-defined]
    return dataclasses.replace(first, positions=positions, scalings=torch.cat([sizes, sizes], dim=1))


@pytest.mark.parametrize("near_depth", [0.05, NEAR_DEPTH, 2.0])
def test_visible_gaussians_equal_those_of_the_statistics(near_depth: float) -> None:
    cameras = to_tensors(dataclasses.replace(tiny_cameras(3, 64, 48), near_depth=near_depth))
    rng = torch.Generator().manual_seed(0)
    means, scales = 3 * torch.randn(3000, 3, generator=rng), torch.exp(torch.randn(3000, 3, generator=rng) - 3)
    gaussians = Gaussians(means, torch.ones(3000, 4) / 2, scales, torch.ones(3000), scales)
    for view in range(3):
        expected = on_image_reference(gaussians, cameras, view)
        assert 0 < int(expected.sum()) < 3000
        assert int((on_image(ViewConstants.of(cameras), view, gaussians) != expected).sum()) <= 2


def test_gaussian_list_contains_all_existing_ones() -> None:
    scene, cameras = to_tensors((tiny_scene(num_anchors=60), tiny_cameras(2, 48, 32)))
    anchors, center = scene.anchors, cameras.centers[0]
    everything = torch.ones(anchors.num_anchors, dtype=torch.bool)
    weight, gain = anchors.mask.float(), torch.linspace(1, 2, anchors.num_anchors)
    expected = gaussian_heads.spawn_gaussians(
        anchors, scene.heads, center, everything, size_gain=gain, mask_weight=weight
    )
    found = spawn_all(anchors, scene.heads, center, weight, gain)
    assert int(found.num_drawn) == expected.gaussians.num_gaussians > 0
    for name, value in vars(found.gaussians).items():
        value = torch.nn.functional.normalize(value, dim=1) if name == "quats" else value
        chosen = value[found.drawn]
        reference = getattr(expected.gaussians, name)
        torch.testing.assert_close(chosen, reference, atol=1e-5, rtol=1e-4, msg=name)
    assert not bool(found.gaussians.opacities[~found.drawn].any())


def test_samples_have_the_requested_size_and_follow_the_generator() -> None:
    device = torch.device("cpu")
    for draw in (sample_from_host, sample_on_device):
        first, again, other = (draw(5000, 0.1, torch.Generator().manual_seed(seed), device) for seed in (0, 0, 1))
        assert torch.equal(first, again)
        assert not torch.equal(first, other)
        assert len(first) == pytest.approx(500, abs=5 * math.sqrt(500))
        assert 0 <= int(first.min()) < int(first.max()) < 5000
        assert float(first.double().mean()) == pytest.approx(2500, abs=400)
