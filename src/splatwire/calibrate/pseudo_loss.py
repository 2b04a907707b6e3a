"""What a sender calibrates on: its complete scene, and pseudo-losses of whole packets (paper, 3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from splatwire.codec.tiers import arrange_stream
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, Partial
from splatwire.ops.arrays import to_arrays
from splatwire.packets import PacketGroups, SceneStream
from splatwire.scene import Cameras


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a sender calibrates on.

    Attributes:
        complete: The complete scene as a decoder returns it.
        groups: Anchors by packet.
        cameras: Where a loss in the picture looks from; None without one.
    """

    complete: Partial[AnchorScene]
    groups: PacketGroups
    cameras: Cameras | None = None

    @property
    def scene(self) -> AnchorScene:
        """The scene itself."""
        return self.complete.scene

    def pseudo_losses(self, rates: Sequence[float], seed: int | np.random.SeedSequence) -> list[Bool[np.ndarray, "N"]]:
        """Draws a loss for each of the rates: which anchors are known after it."""
        seeds = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        each = zip(rates, seeds.generate_state(len(rates)).tolist(), strict=True)
        return [pseudo_loss(self.groups, self.complete.scene.num_elements, rate, number) for rate, number in each]


def calibration_data(
    stream: SceneStream, complete: Partial[AnchorScene], cameras: Cameras | None = None
) -> CalibrationData:
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
    return CalibrationData(to_arrays(complete), groups, cameras)


def dropped_packets(count: int, rate: float, seed: int) -> list[int]:
    """Draws which of so many packets are dropped: a share of them, at least one and not all."""
    return np.random.default_rng(seed).permutation(count)[: min(max(round(rate * count), 1), count - 1)].tolist()


def pseudo_loss(groups: PacketGroups, num_anchors: int, rate: float, seed: int) -> Bool[np.ndarray, "N"]:
    """Draws which anchors are known after a share of the packets, at least one and not all, was dropped."""
    count = len(groups.starts) - 1
    known = np.ones(num_anchors, np.bool_)
    for group in dropped_packets(count, rate, seed):
        known[groups.ranks[groups.starts[group] : groups.starts[group + 1]]] = False
    return known
