"""Fits the side information of the codec `causal` to a scene.

The weights of the networks are quantised coarsely, up to a tolerated error of the networks' outputs.
"""

import math
from collections.abc import Callable

import numpy as np

from splatwire.anchors.causal_prediction import position_inputs, predict_causal
from splatwire.codec.anchors.causal.positions import encode_coarse_positions
from splatwire.codec.anchors.causal.side_info import LOG_BITS, SideInfo
from splatwire.codec.anchors.head_quantisation import SAMPLE_SEED, quantise_heads
from splatwire.codec.quantised_networks import quantise_network
from splatwire.ops.arrays import lower_median
from splatwire.types import AnchorScene, CausalCoding
from splatwire.types.causal_coding import MASK_AND_SCALE

SAMPLE_ANCHORS = 16_000
TOLERANCE_REFERENCE = 0.04
ANCHORS_REFERENCE = 35_000
"""Tolerated error of a mean relative to the predicted deviation, at 35,000 anchors; proportional to the inverse square
root of their number. Weight bytes decrease with the logarithm of the error, attribute bytes grow with its square. Side
information counts for more than its bytes, because all packets need it: lego is smallest with 0.03, and 0.1 % larger
with 0.04, but with 7 % smaller networks.
"""
CAUSAL_HEAD_TOLERANCE = 0.008
"""Tolerated error of a rendering network's output. A value of 0.004 would add 1.2 kB of side information. It would gain
0.02 dB for lego (at 0.4 % of its bytes) and nothing for snowmiku.
"""
POSITION_TOLERANCE_FACTOR = 2.0
"""Tolerated error of the position network's outputs, relative to their standard deviation. The unit is the tolerated
error of a mean.
"""


def fit_side_info(scene: AnchorScene, voxels: np.ndarray, *, network_tolerance: float | None = None) -> SideInfo:
    """Computes the side information of a scene, with quantised networks.

    Args:
        scene: The scene.
        voxels: int64 (N, 3), voxel indices of its anchors.
        network_tolerance: Tolerated error of the quantised networks' outputs, relative to the predicted standard
            deviation; None for the default.
    """
    coding = scene.causal
    if network_tolerance is None:
        network_tolerance = float(
            np.clip(TOLERANCE_REFERENCE * (ANCHORS_REFERENCE / max(len(voxels), 1)) ** 0.5, 0.01, 0.1)
        )
    index = np.random.default_rng(SAMPLE_SEED).permutation(len(voxels))[:SAMPLE_ANCHORS]
    sample = scene.anchors.select(index)
    steps, groups = coding.steps.astype(np.float64), coding.config.layout.feature_groups
    unit = 2.0**LOG_BITS / math.log(2)
    steps_of_logs = np.maximum(np.rint(steps[len(groups) : -1] * unit), 1).astype(np.int64)
    zero_points = np.rint(coding.zero_points.astype(np.float64) * unit).astype(np.int64)
    inputs, outputs = _evaluate_networks(coding, voxels[index], sample.features, sample.scalings)
    networks = {
        name: quantise_network(network, inputs[name], _tolerance(name, outputs[name], coding) * network_tolerance)
        for name, network in coding.networks.items()
    }
    middle, spread = coding.middle.astype(np.int64), coding.spread.astype(np.int64)
    return SideInfo(
        coding.config, coding.voxel_size, encode_coarse_positions(voxels, 1), middle, spread,
        np.concatenate([steps[: len(groups)], steps[-1:]]), steps_of_logs, zero_points,
        networks, quantise_heads(scene.heads, sample, CAUSAL_HEAD_TOLERANCE),
    )  # fmt: skip


def _evaluate_networks(
    coding: CausalCoding, voxels: np.ndarray, features: np.ndarray, scalings: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Evaluates every network on a sample of anchors, to find how coarsely network weights can be quantised.

    Args:
        coding: The networks before quantisation, with quantisation steps.
        voxels: Positions of the sampled anchors, voxels, int64 (n, 3).
        features: Features of the sampled anchors, (n, F).
        scalings: Scalings of the sampled anchors, (n, 6).

    Returns:
        Inputs and outputs of each network, by name.
    """
    inputs, outputs = dict[str, np.ndarray](), dict[str, np.ndarray]()

    def recording(name: str) -> Callable[[np.ndarray], np.ndarray]:
        def run(x: np.ndarray) -> np.ndarray:
            inputs[name], outputs[name] = x, coding.networks[name](x)
            return outputs[name]

        return run

    groups = coding.config.layout.feature_groups
    step = np.repeat(coding.steps[: len(groups)], groups)
    log_scalings = (np.log(scalings[:, [0, 3, 4, 5]]) - coding.zero_points) / coding.steps[len(groups) :][[0, 1, 1, 1]]
    position_features = position_inputs(((voxels - coding.middle) / coding.spread).astype(np.float32))
    predict_causal(
        {name: recording(name) for name in coding.networks},
        coding.config,
        position_features,
        features / step,
        log_scalings,
    )
    return inputs, outputs


def _tolerance(name: str, outputs: np.ndarray, coding: CausalCoding) -> np.ndarray:
    """Returns the tolerated error of each output of a network, caused by quantisation of the network's weights.

    The caller multiplies them by `network_tolerance`.

    Args:
        name: Name of the network.
        outputs: Outputs of the network for a sample of anchors, (n, out).
        coding: Networks and quantisation steps of the scene.
    """
    # Errors of these sizes cost about the same number of bits in every output.
    if name == "position":
        return POSITION_TOLERANCE_FACTOR * np.maximum(outputs.std(axis=0, dtype=np.float64, ddof=1), 1e-3)
    num_mask_logits = coding.config.layout.num_offsets if name == MASK_AND_SCALE else 0
    log_deviations = outputs[:, num_mask_logits + (outputs.shape[1] - num_mask_logits) // 2 :].astype(np.float64)
    typical = lower_median(2.0 ** log_deviations.clip(-3, 13))
    width = np.sqrt(typical**2 + 1 / 12)
    return np.concatenate([np.full(num_mask_logits, 2.0), width, np.ones_like(width)])
