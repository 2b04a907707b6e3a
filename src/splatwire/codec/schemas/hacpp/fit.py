"""From a scene's float model to side information: how precise each network needs to be, and where mask models start."""

import numpy as np
import torch

from splatwire.codec.head_fit import SAMPLE_SEED, fit_heads
from splatwire.codec.heads import quantised
from splatwire.codec.schemas.hacpp.side_info import MASK_CONTEXTS, SideInfo
from splatwire.codec.weights import QuantisedMlp
from splatwire.model import AnchorScene
from splatwire.model.channel_context import channel_parameters
from splatwire.model.hash_grid import interpolate_hash_grid
from splatwire.model.prior_field import PriorOutputs, split_prior_outputs, typical_spread
from splatwire.model.tensors import to_tensors

SAMPLE_ANCHORS = 16_000

NOISE_REFERENCE = 0.035
ANCHORS_REFERENCE = 35_000
"""Tolerated noise of a network output, as a share of the spread that it predicts: 0.035 at 35,000 anchors, falling with
the square root of their number. Weight bytes fall with the logarithm of the noise, attribute bytes grow with its square
and the number of anchors, so the sum is least on such a line (benchmarks/weight_precision.py)."""

STEP_TOLERANCE = 0.05


def fit_side_info(scene: AnchorScene, voxels: np.ndarray, *, noise: float | None = None) -> SideInfo:
    """Quantises everything that all packets of a scene share.

    Args:
        scene: The scene.
        voxels: int64 (N, 3), voxel indices of its anchors.
        noise: Tolerated noise of the context networks, relative to the predicted spread; None for the measured rule.

    Returns:
        Side information ready to be written.
    """
    scene = to_tensors(scene)
    config, grid = scene.hacpp.config, scene.hacpp.context.grid
    if noise is None:
        noise = float(np.clip(NOISE_REFERENCE * (ANCHORS_REFERENCE / max(len(voxels), 1)) ** 0.5, 0.01, 0.05))
    generator = np.random.default_rng(SAMPLE_SEED)
    index = torch.from_numpy(generator.permutation(len(voxels))[:SAMPLE_ANCHORS])
    sample = scene.anchors.select(index)
    with torch.no_grad():
        inputs = interpolate_hash_grid(grid, sample.positions, config.grid)
        outputs = split_prior_outputs(scene.hacpp.context.prior(inputs), config)
    return SideInfo(
        config, scene.hacpp.voxel_size, _float32(grid.bounds_min), _float32(grid.bounds_max), voxels,
        np.concatenate([_signs(grid.volume), *(_signs(plane) for plane in grid.planes)]),
        quantised(scene.hacpp.context.prior, inputs, _prior_tolerance(outputs, scene) * noise),
        _fit_channel(scene, sample.features, outputs, noise),
        fit_heads(scene.heads, sample),
        _fit_masks(scene.anchors.mask.numpy()),
    )  # fmt: skip


def _prior_tolerance(outputs: PriorOutputs, scene: AnchorScene) -> np.ndarray:
    base = scene.hacpp.config.base_steps
    spread_f = _spread(outputs.feature_scale, base[0])
    spread_s, spread_o = _spread(outputs.scaling_scale, base[1]), _spread(outputs.offset_scale, base[2])
    weight = np.ones(len(spread_f))
    steps = np.full(3, STEP_TOLERANCE)
    return np.concatenate([spread_f, spread_f, weight, spread_s, spread_s, spread_o, spread_o, steps])


def _spread(scale: torch.Tensor, step: float) -> np.ndarray:
    return typical_spread(scale.double(), step).numpy()


def _fit_channel(
    scene: AnchorScene, features: torch.Tensor, outputs: PriorOutputs, noise: float
) -> tuple[QuantisedMlp, ...]:
    fitted, edges = [], np.cumsum([0, *scene.hacpp.config.layout.feature_groups])
    prior = [outputs.feature_mean, outputs.feature_scale, outputs.feature_weight]
    for group, network in enumerate(scene.hacpp.context.channel):
        before = features[:, : int(edges[group])]
        with torch.no_grad():
            scale = channel_parameters(scene.hacpp.context, group, before, outputs).scale
        spread = _spread(scale, scene.hacpp.config.base_steps[0])
        tolerance = np.concatenate([spread, spread, np.ones(len(spread))]) * noise
        fitted.append(quantised(network, torch.cat([before, *prior], dim=1), tolerance))
    return tuple(fitted)


def _fit_masks(mask: np.ndarray) -> np.ndarray:
    """Initial P(0) of each mask model, out of 2**8: its frequency over all anchors."""
    ones = np.minimum(np.cumsum(mask, axis=1) - mask, MASK_CONTEXTS - 1)
    zero = np.full((mask.shape[1], MASK_CONTEXTS), 128, dtype=np.int64)
    for k in range(mask.shape[1]):
        for c in range(MASK_CONTEXTS):
            bits = mask[ones[:, k] == c, k]
            if len(bits):
                zero[k, c] = np.clip(round(256 * (1 - bits.mean())), 1, 255)
    return zero.ravel()


def _float32(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().float().numpy().astype(np.float32)


def _signs(table: torch.Tensor) -> np.ndarray:
    return table.numpy().astype(np.int8)
