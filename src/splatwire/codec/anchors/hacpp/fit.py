"""Fits the side information of the codec `hacpp` to a scene: network precision and initial models of offset masks."""

import numpy as np

from splatwire.codec.anchors.hacpp.coding_params import PriorColumns, prior_columns
from splatwire.codec.anchors.hacpp.grid_lookup import lookup, unit_coordinates
from splatwire.codec.anchors.hacpp.side_info import MASK_CONTEXTS, SideInfo
from splatwire.codec.anchors.head_quantisation import SAMPLE_SEED, quantise_heads
from splatwire.codec.fixed_point import ACTIVATION_BITS
from splatwire.codec.quantised_networks import quantise_network
from splatwire.codec.weights import QuantisedMlp
from splatwire.ops.arrays import lower_median
from splatwire.types import AnchorScene, HacppConfig
from splatwire.types.prior import MIN_SCALE

SAMPLE_ANCHORS = 16_000

TOLERANCE_REFERENCE = 0.035
ANCHORS_REFERENCE = 35_000
"""Tolerated error of a network output relative to its predicted standard deviation: 0.035 at 35,000 anchors,
proportional to the inverse square root of their number. Weight bytes decrease with the logarithm of the error;
attribute bytes grow with its square and the number of anchors. This rule minimises their sum
(benchmarks/weight_precision.py).
"""

STEP_TOLERANCE = 0.05


def fit_side_info(scene: AnchorScene, voxels: np.ndarray, *, network_tolerance: float | None = None) -> SideInfo:
    """Computes the side information of a scene: quantised networks and initial models of offset masks.

    Args:
        scene: The scene.
        voxels: int64 (N, 3), voxel indices of its anchors.
        network_tolerance: Tolerated error of the quantised networks' outputs, relative to the predicted standard
            deviation; None for the default.

    Returns:
        The side information.

    Raises:
        InvalidValueError: If the box of the hash grid is too thin for the voxels.
    """
    config, context = scene.hacpp.config, scene.hacpp.context_model
    if network_tolerance is None:
        network_tolerance = float(
            np.clip(TOLERANCE_REFERENCE * (ANCHORS_REFERENCE / max(len(voxels), 1)) ** 0.5, 0.01, 0.05)
        )
    index = np.random.default_rng(SAMPLE_SEED).permutation(len(voxels))[:SAMPLE_ANCHORS]
    sample, columns = scene.anchors.select(index), prior_columns(config)
    signs = np.concatenate([context.grid.volume, *context.grid.planes]).astype(np.int8)
    bounds = context.grid.bounds_min.astype(np.float32), context.grid.bounds_max.astype(np.float32)
    # inputs as computed by encoder and decoder, converted to floats
    inputs = lookup(unit_coordinates(voxels[index], scene.hacpp.voxel_size, *bounds), signs, config.grid)
    inputs = (inputs * 2.0**-ACTIVATION_BITS).astype(np.float32)
    outputs = context.prior(inputs)
    return SideInfo(
        config, scene.hacpp.voxel_size, *bounds, voxels, signs,
        quantise_network(context.prior, inputs, _prior_tolerance(outputs, columns, config) * network_tolerance),
        _fit_channel(scene, sample.features, outputs[:, : columns.scaling_mean], network_tolerance),
        quantise_heads(scene.heads, sample),
        _fit_mask_probabilities(scene.anchors.mask),
    )  # fmt: skip


def typical_spread(scale: np.ndarray, step: float) -> np.ndarray:
    """Returns the typical standard deviation of each channel of an attribute, including the rounding error.

    Args:
        scale: Predicted standard deviations of the D channels for a sample of anchors, (n, D).
        step: Base quantisation step of the attribute, in the unit of `scale`.

    Returns:
        Standard deviation of each channel in the unit of `scale`, float64 (D).
    """
    typical = lower_median(np.maximum(scale.astype(np.float64), step * 1e-3))
    return np.sqrt(typical**2 + step**2 / 12)


def _prior_tolerance(outputs: np.ndarray, columns: PriorColumns, config: HacppConfig) -> np.ndarray:
    """Returns the tolerated error of each output of the prior network, caused by quantisation of the weights.

    Errors of these sizes cost about the same number of bits in every output. The caller
    multiplies them by `network_tolerance`.

    Args:
        outputs: Outputs of the prior network for a sample of anchors.
        columns: First column of each predicted quantity in `outputs`.
        config: Sizes of the model's networks and tables.
    """
    # For the mean and the standard deviation of a channel, the error is the channel's typical standard deviation.
    feature, scaling, offset = config.base_steps
    feature_deviations = typical_spread(outputs[:, columns.feature_scale : columns.feature_weight], feature)
    scaling_deviations = typical_spread(outputs[:, columns.scaling_scale : columns.offset_mean], scaling)
    offset_deviations = typical_spread(outputs[:, columns.offset_scale : columns.steps], offset)
    weight, steps = np.ones(len(feature_deviations)), np.full(3, STEP_TOLERANCE)
    return np.concatenate(
        [
            feature_deviations,
            feature_deviations,
            weight,
            scaling_deviations,
            scaling_deviations,
            offset_deviations,
            offset_deviations,
            steps,
        ]
    )


def _fit_channel(
    scene: AnchorScene, features: np.ndarray, prior: np.ndarray, network_tolerance: float
) -> tuple[QuantisedMlp, ...]:
    """Quantises the channel networks, each of which predicts one feature group from the groups before it.

    Args:
        scene: The scene with the networks.
        features: Features of a sample of anchors.
        prior: Outputs of the prior network for the features of these anchors: means, standard deviations, and mixture
            weights as logits.
        network_tolerance: Tolerated quantisation error of the networks' outputs, relative to the predicted standard
            deviation.
    """
    fitted, before = [], 0
    for network, size in zip(scene.hacpp.context_model.channel, scene.hacpp.config.layout.feature_groups, strict=True):
        inputs = np.concatenate([features[:, :before], prior], axis=1)
        scale = np.maximum(network(inputs)[:, size : 2 * size], MIN_SCALE)
        deviations = typical_spread(scale, scene.hacpp.config.base_steps[0])
        tolerance = np.concatenate([deviations, deviations, np.ones(size)]) * network_tolerance
        fitted.append(quantise_network(network, inputs, tolerance))
        before += size
    return tuple(fitted)


def _fit_mask_probabilities(mask: np.ndarray) -> np.ndarray:
    """Returns the initial probability that a bit is 0, for each adaptive model of mask bits, in units of 2**-8."""
    # It is the frequency of such bits in the whole scene.
    contexts = np.minimum(np.cumsum(mask, axis=1) - mask, MASK_CONTEXTS - 1)
    probabilities = np.full((mask.shape[1], MASK_CONTEXTS), 128, dtype=np.int64)
    for k in range(mask.shape[1]):
        for c in range(MASK_CONTEXTS):
            bits = mask[contexts[:, k] == c, k]
            if len(bits):
                probabilities[k, c] = np.clip(round(256 * (1 - bits.mean())), 1, 255)
    return probabilities.ravel()
