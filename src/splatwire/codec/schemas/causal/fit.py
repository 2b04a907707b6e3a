"""From a scene's float model to side information: how precise each network needs to be."""

import math
from collections.abc import Callable

import numpy as np
import torch

from splatwire.codec.head_fit import SAMPLE_SEED, fit_heads
from splatwire.codec.heads import quantised
from splatwire.codec.schemas.causal.places import share_places
from splatwire.codec.schemas.causal.side_info import LOG_BITS, SideInfo
from splatwire.model import AnchorScene, CausalCoding
from splatwire.model.causal_prediction import place_inputs, predict_causal
from splatwire.model.tensors import to_tensors

SAMPLE_ANCHORS = 16_000
NOISE_REFERENCE = 0.04
ANCHORS_REFERENCE = 35_000
"""Tolerated noise of a mean, as a share of the spread around it, at 35,000 anchors; it falls with the square root of
their number: weight bytes fall with the logarithm of the noise, attribute bytes grow with its square. Bytes that all
packets need count for more: lego takes fewest with 0.03, and 0.1 % more with 0.04, of which 7 % less are networks."""
HEAD_TOLERANCE = 0.008
"""Tolerated noise of a rendering network's output: with 0.004 side information grows by 1.2 kB, which is worth 0.02 dB
of lego (0.4 % of its bytes) and nothing of snowmiku."""
PLACE_SHARE = 2.0
"""Tolerated noise of the numbers that describe a place, in units of that of a mean, as a share of their own spread."""


def fit_side_info(scene: AnchorScene, voxels: np.ndarray, *, noise: float | None = None) -> SideInfo:
    """Quantises everything that all packets of a scene share; of places it keeps nearly all for itself.

    Args:
        scene: The scene.
        voxels: int64 (N, 3), voxel indices of its anchors.
        noise: Tolerated noise of the context networks, relative to the predicted spread; None for the measured rule.
    """
    voxels_of, scene = torch.from_numpy(voxels), to_tensors(scene)
    coding = scene.causal
    if noise is None:
        noise = float(np.clip(NOISE_REFERENCE * (ANCHORS_REFERENCE / max(len(voxels), 1)) ** 0.5, 0.01, 0.1))
    index = torch.from_numpy(np.random.default_rng(SAMPLE_SEED).permutation(len(voxels))[:SAMPLE_ANCHORS])
    sample = scene.anchors.select(index)
    steps, groups = coding.steps.double(), coding.config.layout.feature_groups
    unit = 2.0**LOG_BITS / math.log(2)
    logs = torch.round(steps[len(groups) : -1] * unit).clamp(min=1)
    centres = torch.round(coding.centres.double() * unit)
    inputs, outputs = _sampled(coding, voxels_of[index], sample.features, sample.scalings)
    networks = {
        name: quantised(network, inputs[name], _tolerance(name, outputs[name], coding) * noise)
        for name, network in coding.networks.items()
    }
    middle, spread = coding.middle.long().numpy(), coding.spread.long().numpy()
    return SideInfo(
        coding.config, coding.voxel_size, share_places(voxels, 1), middle, spread,
        torch.cat([steps[: len(groups)], steps[-1:]]).numpy(), logs.long().numpy(), centres.long().numpy(),
        networks, fit_heads(scene.heads, sample, HEAD_TOLERANCE),
    )  # fmt: skip


@torch.no_grad()
def _sampled(
    coding: CausalCoding, voxels: torch.Tensor, features: torch.Tensor, scalings: torch.Tensor
) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """Inputs and outputs of every network for some anchors."""
    inputs, outputs = dict[str, torch.Tensor](), dict[str, torch.Tensor]()

    def watched(name: str) -> Callable[[torch.Tensor], torch.Tensor]:
        def run(x: torch.Tensor) -> torch.Tensor:
            inputs[name], outputs[name] = x, coding.networks[name](x)
            return outputs[name]

        return run

    groups = torch.tensor(coding.config.layout.feature_groups)
    step = coding.steps[: len(groups)].repeat_interleave(groups)
    form = (scalings[:, [0, 3, 4, 5]].log() - coding.centres) / coding.steps[len(groups) :][[0, 1, 1, 1]]
    place = place_inputs((voxels - coding.middle) / coding.spread)
    predict_causal({name: watched(name) for name in coding.networks}, coding.config, place, features / step, form)
    return inputs, outputs


def _tolerance(name: str, outputs: torch.Tensor, coding: CausalCoding) -> np.ndarray:
    """Noise of each output that costs about as much as that of a mean by its spread."""
    if name == "position":
        return (PLACE_SHARE * outputs.std(dim=0).clamp(min=1e-3)).double().numpy()
    masks = coding.config.layout.num_offsets if name == "form" else 0
    spread = outputs[:, masks:].chunk(2, dim=1)[1]
    typical = torch.exp2(spread.clamp(-3, 13)).median(dim=0).values
    width = (typical**2 + 1 / 12).sqrt()
    return torch.cat([torch.full((masks,), 2.0), width, torch.ones_like(width)]).double().numpy()
