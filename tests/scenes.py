"""Small synthetic scenes and cameras for tests without data."""

import math

import numpy as np

from random_numbers import Numbers
from splatwire.anchors.voxels import voxel_positions
from splatwire.codec.anchors.hacpp.coding_params import prior_columns
from splatwire.codec.anchors.hacpp.grid_lookup import lookup, unit_coordinates
from splatwire.codec.fixed_point import ACTIVATION_BITS
from splatwire.types import (
    AnchorLayout,
    Anchors,
    AnchorScene,
    Cameras,
    CausalCoding,
    CausalConfig,
    GaussianHeads,
    HacppCoding,
    HacppConfig,
    HacppContextModel,
    HashGrid,
    HashGridConfig,
    Linear,
    Mlp,
)
from splatwire.types.prior import MIN_SCALE

SMALL_CONFIG = HacppConfig(
    AnchorLayout(feature_dim=12, num_offsets=4, feature_groups=(4, 4, 4)),
    HashGridConfig(features_per_level=4, resolutions_3d=(6, 10), resolutions_2d=(12,), log2_rows_3d=8, log2_rows_2d=8),
)
"""A model with few channels, a tiny hash grid and three feature groups, for fast tests."""
VOXEL_SIZE = 1 / 64
"""A power of two, so that every product with an index is exact."""
HALF_SIDE = 48
"""Anchors lie within this many voxels of the origin."""


def tiny_scene(seed: int = 0, num_anchors: int = 300, config: HacppConfig = SMALL_CONFIG) -> AnchorScene:
    """Creates a scene of random anchors with attributes drawn from its random context model.

    Args:
        seed: Seed of all random choices.
        num_anchors: Anchors, all at different voxels of a cube around the origin; each has at least one offset.
        config: Shape of the model; `HacppConfig()` gives the full size.
    """
    rng = Numbers(seed)
    voxels = _voxels(num_anchors, rng)
    context = _context(config, rng)
    anchors = _anchors(voxels, context, config, rng)
    return AnchorScene(anchors, _heads(config, rng), HacppCoding(context, VOXEL_SIZE, config))


def _voxels(count: int, rng: Numbers) -> np.ndarray:
    """Voxel indices around the origin, all different, int64 (count, 3)."""
    side = 2 * HALF_SIDE + 1
    cells = rng.randperm(side**3, count)
    return np.stack([cells // side**2, cells // side % side, cells % side], axis=1) - HALF_SIDE


def tiny_cameras(num_views: int = 3, width: int = 96, height: int = 64, distance: float = 3.0) -> Cameras:
    """Places cameras on a circle around the origin, all directed at it."""
    poses = []
    for view in range(num_views):
        angle = 2 * math.pi * view / num_views
        center = np.float32([distance * math.sin(angle), -0.4, -distance * math.cos(angle)])
        forward = -center / np.linalg.norm(center)
        right = np.cross(np.float32([0, 1, 0]), forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4, dtype=np.float32)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
        poses.append(pose)
    intrinsics = np.float32([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    names = tuple(f"view_{view:02d}" for view in range(num_views))
    return Cameras(np.stack(poses), np.repeat(intrinsics[None], num_views, axis=0), width, height, names)


def _linear(inputs: int, outputs: int, rng: Numbers, gain: float = 1.0) -> Linear:
    weight = rng.randn(outputs, inputs) * np.float32(gain / math.sqrt(inputs))
    return Linear(weight, np.float32(0.1) * rng.randn(outputs))


def _mlp(inputs: int, hidden: int, outputs: int, rng: Numbers, slope: float = 0.0, gain: float = 1.0) -> Mlp:
    return Mlp(_linear(inputs, hidden, rng), _linear(hidden, outputs, rng, gain), slope)


def _context(config: HacppConfig, rng: Numbers) -> HacppContextModel:
    layout, grid = config.layout, config.grid

    def signs(*shape: int) -> np.ndarray:
        return rng.signs(shape).astype(np.int8)

    extent = np.full(3, (HALF_SIDE + 2) * VOXEL_SIZE, np.float32)
    depth = grid.features_per_level
    tables = HashGrid(signs(sum(grid.rows(3)), depth), signs(3, sum(grid.rows(2)), depth), -extent, extent)
    prior = _prior_network(config, rng)
    before = [sum(layout.feature_groups[:g]) for g in range(len(layout.feature_groups))]
    channel = tuple(
        _with_positive_scales(_mlp(b + 3 * layout.feature_dim, 24, 3 * size, rng, 0.01, 0.5), slice(size, 2 * size))
        for b, size in zip(before, layout.feature_groups, strict=True)
    )
    return HacppContextModel(tables, prior, channel)


def _with_positive_scales(network: Mlp, columns: slice, center: float = 2.0) -> Mlp:
    bias = network.output.bias.copy()
    bias[columns] = center
    return Mlp(network.hidden, Linear(network.output.weight, bias), network.negative_slope)


def _prior_network(config: HacppConfig, rng: Numbers) -> Mlp:
    """A random prior with scalings and offsets of the size of a scene of this extent."""
    features, offsets = config.layout.feature_dim, 3 * config.layout.num_offsets
    widths = [features] * 3 + [6] * 2 + [offsets] * 2 + [3]
    gains = [1.5, 0.3, 0.5, 0.02, 0.002, 0.3, 0.1, 0.3]
    centers = [0.0, 2.0, 0.0, 0.12, 0.02, 0.0, 0.8, 0.0]
    network = _mlp(config.grid.context_dim, 32, config.prior_dim, rng)
    gain, center = (np.repeat(np.float32(values), widths) for values in (gains, centers))
    output = Linear(network.output.weight * gain[:, None], network.output.bias * gain + center)
    return Mlp(network.hidden, output)


def _anchors(voxels: np.ndarray, context: HacppContextModel, config: HacppConfig, rng: Numbers) -> Anchors:
    """Draws attributes from the prior and channel networks and rounds them to their steps, like a decoder."""
    num, layout, grid, columns = len(voxels), config.layout, context.grid, prior_columns(config)
    units = unit_coordinates(voxels, VOXEL_SIZE, grid.bounds_min, grid.bounds_max)
    found = lookup(units, np.concatenate([grid.volume, *grid.planes]), config.grid) * 2.0**-ACTIVATION_BITS
    outputs = context.prior(found.astype(np.float32))
    steps = np.float32(config.base_steps) * (1 + np.tanh(outputs[:, columns.steps :]))
    features = np.empty((num, 0), np.float32)
    for network, size in zip(context.channel, layout.feature_groups, strict=True):
        mean, scale, _ = np.split(
            network(np.concatenate([features, outputs[:, : columns.scaling_mean]], axis=1)), 3, axis=1
        )
        drawn = mean + np.abs(np.maximum(scale, MIN_SCALE)) * rng.randn(num, size)
        features = np.concatenate([features, _rounded(drawn, steps[:, :1])], axis=1)
    scaling_mean, scaling_scale = outputs[:, columns.scaling_mean :][:, :6], outputs[:, columns.scaling_scale :][:, :6]
    scalings = scaling_mean + np.maximum(scaling_scale, MIN_SCALE) * rng.randn(num, 6)
    scalings = _rounded(np.maximum(scalings, np.float32(0.02)), steps[:, 1:2])
    mask, width = _mask(num, layout.num_offsets, rng), 3 * layout.num_offsets
    offset_mean, offset_scale = (outputs[:, first:][:, :width] for first in (columns.offset_mean, columns.offset_scale))
    offsets = offset_mean + np.maximum(offset_scale, MIN_SCALE) * rng.randn(num, width)
    offsets = _rounded(offsets, steps[:, 2:]).reshape(num, layout.num_offsets, 3) * mask[:, :, None]
    return Anchors(voxel_positions(voxels, VOXEL_SIZE), features, scalings, offsets, mask)


def _mask(num: int, num_offsets: int, rng: Numbers) -> np.ndarray:
    """Which offsets exist; at least one of each anchor."""
    mask = rng.rand(num, num_offsets) < 0.4
    mask[np.arange(num), rng.randint(num_offsets, num)] = True
    return mask


def _rounded(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    return np.rint(values / step) * step


def _heads(config: HacppConfig | CausalConfig, rng: Numbers) -> GaussianHeads:
    inputs, offsets = config.layout.feature_dim + 4, config.layout.num_offsets
    opacity = _mlp(inputs, 16, offsets, rng)
    opacity = Mlp(opacity.hidden, Linear(opacity.output.weight, opacity.output.bias + np.float32(0.8)))
    return GaussianHeads(opacity, _mlp(inputs, 16, 7 * offsets, rng), _mlp(inputs, 16, 3 * offsets, rng))


SMALL_CAUSAL = CausalConfig(AnchorLayout(feature_dim=12, num_offsets=4, feature_groups=(1, 1, 2, 8)), context_dim=6)
"""The causal model with few channels."""


def tiny_causal_scene(seed: int = 0, num_anchors: int = 300, config: CausalConfig = SMALL_CAUSAL) -> AnchorScene:
    """Creates a scene of random anchors under a random causal model, at different voxels around the origin."""
    rng, layout = Numbers(seed), config.layout
    voxels = _voxels(num_anchors, rng)
    networks = {name: _mlp(inputs, 16, out, rng, 0.01) for name, (inputs, out) in config.shapes().items()}
    mask = _mask(num_anchors, layout.num_offsets, rng)
    scalings = np.exp(np.float32(0.4) * rng.randn(num_anchors, 4) - np.float32(2.5))[:, [0, 0, 0, 1, 2, 3]]
    offsets = rng.randn(num_anchors, layout.num_offsets, 3) * mask[:, :, None]
    features = 2 * rng.randn(num_anchors, layout.feature_dim)
    anchors = Anchors(voxel_positions(voxels, VOXEL_SIZE), features, scalings, offsets, mask)
    steps = np.float32([0.5] * len(layout.feature_groups) + [0.3, 0.1, 0.2])
    middle, spread = np.zeros(3, np.float32), np.full(3, HALF_SIDE / 2, np.float32)
    coding = CausalCoding(networks, steps, np.full(4, -2.5, np.float32), middle, spread, VOXEL_SIZE, config)
    return AnchorScene(anchors, _heads(config, rng), coding)
