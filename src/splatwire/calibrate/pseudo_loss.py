"""What a sender calibrates on: its complete scene, and pseudo-losses of whole packets (paper, 3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from splatwire.codec.tiers import arrange_stream
from splatwire.conceal import AnchorContext, context_of
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import PacketGroups, SceneStream
from splatwire.scene import Cameras, Erasures


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a sender calibrates on.

    Attributes:
        scene: The complete scene as a decoder returns it.
        context: The same for a concealer, nothing lost.
        groups: Anchors by packet.
        cameras: Where a loss in the picture looks from; None without one.
    """

    scene: AnchorScene
    context: AnchorContext
    groups: PacketGroups
    cameras: Cameras | None = None

    def pseudo_losses(self, rates: Sequence[float], seed: int | np.random.SeedSequence) -> list[Bool[Tensor, "N"]]:
        """Draws a loss for each of the rates: which anchors are known after it."""
        seeds = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        each = zip(rates, seeds.generate_state(len(rates)).tolist(), strict=True)
        return [pseudo_loss(self.groups, self.context.anchors.num_anchors, rate, number) for rate, number in each]


def calibration_data(stream: SceneStream, complete: PartialScene, cameras: Cameras | None = None) -> CalibrationData:
    """Prepares a decoded stream.

    Args:
        stream: The complete stream: it says which anchors share a packet.
        complete: What the decoder made of it.
        cameras: Where a loss in the picture looks from.

    Raises:
        InvalidValueError: If something was lost, or there are fewer than two packets.
    """
    groups = arrange_stream(stream).groups
    if complete.erasures.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(groups.starts) < 3:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    return CalibrationData(complete.scene, context_of(complete).to_cpu(), groups, cameras)


def dropped_packets(count: int, rate: float, seed: int) -> list[int]:
    """Draws which of so many packets are dropped: a share of them, at least one and not all."""
    return np.random.default_rng(seed).permutation(count)[: min(max(round(rate * count), 1), count - 1)].tolist()


def pseudo_loss(groups: PacketGroups, num_anchors: int, rate: float, seed: int) -> Bool[Tensor, "N"]:
    """Draws which anchors are known after a share of the packets, at least one and not all, was dropped."""
    count = len(groups.starts) - 1
    known = torch.ones(num_anchors, dtype=torch.bool)
    for group in dropped_packets(count, rate, seed):
        known[torch.from_numpy(groups.ranks[groups.starts[group] : groups.starts[group + 1]])] = False
    return known


def without(context: AnchorContext, known: Bool[Tensor, "N"]) -> AnchorContext:
    """The context that a receiver has when only `known` anchors have arrived."""
    return replace(
        context, anchors=context.anchors.arrived(known, context.guessed), erasures=Erasures.of_anchors(known)
    )
