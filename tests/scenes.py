"""Small made-up scenes and cameras, so that the whole journey can be tested without any data."""

import math

import torch

from splatwire.model import (
    AnchorScene,
    CausalCoding,
    CausalConfig,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    HashGridConfig,
    Linear,
    Mlp,
    ModelConfig,
)
from splatwire.model.channel_context import channel_parameters
from splatwire.model.hash_grid import interpolate_hash_grid
from splatwire.model.prior_field import prior_of, split_prior_outputs
from splatwire.model.voxels import voxel_positions
from splatwire.ops.arrays import to_arrays
from splatwire.scene import AnchorLayout, Anchors, Cameras

SMALL_CONFIG = ModelConfig(
    AnchorLayout(feature_dim=12, num_offsets=4, feature_groups=(4, 4, 4)),
    HashGridConfig(features_per_level=4, resolutions_3d=(6, 10), resolutions_2d=(12,), log2_rows_3d=8, log2_rows_2d=8),
)
"""A model with few channels, a tiny hash grid and three feature groups: everything is quick on it."""
VOXEL_SIZE = 1 / 64
"""A power of two, so that every product with an index is exact."""
HALF_SIDE = 48
"""Anchors lie within this many voxels of the origin."""


def tiny_scene(seed: int = 0, num_anchors: int = 300, config: ModelConfig = SMALL_CONFIG) -> AnchorScene:
    """Makes a scene of random anchors whose attributes really follow the scene's own (random) context model.

    Args:
        seed: Seed of everything.
        num_anchors: Anchors, all at different voxels of a cube around the origin; each has at least one offset.
        config: Shape of the model; `ModelConfig()` gives the full size.
    """
    rng = torch.Generator().manual_seed(seed)
    side = 2 * HALF_SIDE + 1
    cells = torch.randperm(side**3, generator=rng)[:num_anchors]
    voxels = torch.stack([cells // side**2, cells // side % side, cells % side], dim=1) - HALF_SIDE
    positions = voxel_positions(voxels, VOXEL_SIZE)
    context = _context(config, rng)
    anchors = _anchors(torch.from_numpy(positions), context, config, rng)
    return to_arrays(AnchorScene(anchors, _heads(config, rng), HacppCoding(context, VOXEL_SIZE, config)))


def tiny_cameras(num_views: int = 3, width: int = 96, height: int = 64, distance: float = 3.0) -> Cameras:
    """Places cameras on a circle around the origin, all looking at it."""
    poses = []
    for view in range(num_views):
        angle = 2 * math.pi * view / num_views
        center = torch.tensor([distance * math.sin(angle), -0.4, -distance * math.cos(angle)])
        forward = -center / center.norm()
        right = torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), forward)
        right = right / right.norm()
        rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
        pose = torch.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
        poses.append(pose)
    intrinsics = torch.tensor([[float(width), 0.0, width / 2], [0.0, float(width), height / 2], [0.0, 0.0, 1.0]])
    names = tuple(f"view_{view:02d}" for view in range(num_views))
    return to_arrays(Cameras(torch.stack(poses), intrinsics.repeat(num_views, 1, 1), width, height, names))


def _linear(inputs: int, outputs: int, rng: torch.Generator, gain: float = 1.0) -> Linear:
    weight = torch.randn(outputs, inputs, generator=rng) * (gain / math.sqrt(inputs))
    return Linear(weight, 0.1 * torch.randn(outputs, generator=rng))


def _mlp(inputs: int, hidden: int, outputs: int, rng: torch.Generator, slope: float = 0.0, gain: float = 1.0) -> Mlp:
    return Mlp(_linear(inputs, hidden, rng), _linear(hidden, outputs, rng, gain), slope)


def _context(config: ModelConfig, rng: torch.Generator) -> ContextModel:
    layout, grid = config.layout, config.grid

    def signs(*shape: int) -> torch.Tensor:
        return (torch.randint(0, 2, shape, generator=rng) * 2 - 1).to(torch.int8)

    extent = torch.full((3,), (HALF_SIDE + 2) * VOXEL_SIZE)
    depth = grid.features_per_level
    tables = HashGrid(signs(sum(grid.rows(3)), depth), signs(3, sum(grid.rows(2)), depth), -extent, extent)
    prior = _prior_network(config, rng)
    before = [sum(layout.feature_groups[:g]) for g in range(len(layout.feature_groups))]
    channel = tuple(
        _with_positive_scales(_mlp(b + 3 * layout.feature_dim, 24, 3 * size, rng, 0.01, 0.5), slice(size, 2 * size))
        for b, size in zip(before, layout.feature_groups, strict=True)
    )
    return ContextModel(tables, prior, channel)


def _with_positive_scales(network: Mlp, columns: slice, center: float = 2.0) -> Mlp:
    bias = network.output.bias.clone()
    bias[columns] = center
    return Mlp(network.hidden, Linear(network.output.weight, bias), network.negative_slope)


def _prior_network(config: ModelConfig, rng: torch.Generator) -> Mlp:
    """A random prior whose scalings and offsets are of the size that a scene of this extent needs."""
    features, offsets = config.layout.feature_dim, 3 * config.layout.num_offsets
    widths = [features] * 3 + [6] * 2 + [offsets] * 2 + [3]
    gains = [1.5, 0.3, 0.5, 0.02, 0.002, 0.3, 0.1, 0.3]
    centers = [0.0, 2.0, 0.0, 0.12, 0.02, 0.0, 0.8, 0.0]
    network = _mlp(config.grid.context_dim, 32, config.prior_dim, rng)
    gain = torch.cat([torch.full((w,), g) for w, g in zip(widths, gains, strict=True)])
    center = torch.cat([torch.full((w,), c) for w, c in zip(widths, centers, strict=True)])
    output = Linear(network.output.weight * gain[:, None], network.output.bias * gain + center)
    return Mlp(network.hidden, output)


@torch.no_grad()
def _anchors(positions: torch.Tensor, context: ContextModel, config: ModelConfig, rng: torch.Generator) -> Anchors:
    """Draws attributes from the prior and channel networks and rounds them to their steps, as a decoder would."""
    num, layout = len(positions), config.layout
    grid_feature = interpolate_hash_grid(context.grid, positions, config.grid)
    outputs = split_prior_outputs(context.prior(grid_feature), config)
    prior = prior_of(outputs, grid_feature, config)
    features = torch.empty(num, 0)
    for group, size in enumerate(layout.feature_groups):
        own = channel_parameters(context, group, features, outputs)
        noise = torch.randn(num, size, generator=rng)
        features = torch.cat([features, _rounded(own.mean + own.scale.abs() * noise, prior.feature.step)], dim=1)
    scalings = prior.scaling.mean + prior.scaling.scale * torch.randn(num, 6, generator=rng)
    scalings = _rounded(scalings.clamp(min=0.02), prior.scaling.step)
    mask = torch.rand(num, layout.num_offsets, generator=rng) < 0.4
    mask[torch.arange(num), torch.randint(0, layout.num_offsets, (num,), generator=rng)] = True
    offsets = prior.offset.mean + prior.offset.scale * torch.randn(num, 3 * layout.num_offsets, generator=rng)
    offsets = _rounded(offsets, prior.offset.step).reshape(num, layout.num_offsets, 3) * mask[:, :, None]
    return Anchors(positions, features, scalings, offsets, mask)


def _rounded(values: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    return torch.round(values / step) * step


def _heads(config: ModelConfig | CausalConfig, rng: torch.Generator) -> GaussianHeads:
    inputs, offsets = config.layout.feature_dim + 4, config.layout.num_offsets
    opacity = _mlp(inputs, 16, offsets, rng)
    opacity = Mlp(opacity.hidden, Linear(opacity.output.weight, opacity.output.bias + 0.8))
    return GaussianHeads(opacity, _mlp(inputs, 16, 7 * offsets, rng), _mlp(inputs, 16, 3 * offsets, rng))


SMALL_CAUSAL = CausalConfig(AnchorLayout(feature_dim=12, num_offsets=4, feature_groups=(1, 1, 2, 8)), context_dim=6)
"""The causal model with few channels."""


def tiny_causal_scene(seed: int = 0, num_anchors: int = 300, config: CausalConfig = SMALL_CAUSAL) -> AnchorScene:
    """Makes a scene of random anchors under a random causal model, all at different voxels around the origin."""
    rng = torch.Generator().manual_seed(seed)
    side, layout = 2 * HALF_SIDE + 1, config.layout
    cells = torch.randperm(side**3, generator=rng)[:num_anchors]
    voxels = torch.stack([cells // side**2, cells // side % side, cells % side], dim=1) - HALF_SIDE
    networks = {name: _mlp(inputs, 16, out, rng, 0.01) for name, (inputs, out) in config.shapes().items()}
    mask = torch.rand(num_anchors, layout.num_offsets, generator=rng) < 0.4
    mask[torch.arange(num_anchors), torch.randint(0, layout.num_offsets, (num_anchors,), generator=rng)] = True
    scalings = (0.4 * torch.randn(num_anchors, 4, generator=rng) - 2.5).exp()[:, [0, 0, 0, 1, 2, 3]]
    offsets = torch.randn(num_anchors, layout.num_offsets, 3, generator=rng) * mask[:, :, None]
    features = 2 * torch.randn(num_anchors, layout.feature_dim, generator=rng)
    anchors = Anchors(torch.from_numpy(voxel_positions(voxels, VOXEL_SIZE)), features, scalings, offsets, mask)
    steps = torch.tensor([0.5] * len(layout.feature_groups) + [0.3, 0.1, 0.2])
    spread = torch.full((3,), HALF_SIDE / 2)
    coding = CausalCoding(networks, steps, torch.full((4,), -2.5), torch.zeros(3), spread, VOXEL_SIZE, config)
    return to_arrays(AnchorScene(anchors, _heads(config, rng), coding))
