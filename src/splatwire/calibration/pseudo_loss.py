"""Data for calibrations by the sender: the complete scene, and simulated losses of packets (paper, Section 3.4)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from splatwire.arguments import checked
from splatwire.bitstream import PacketMembers, SceneStream
from splatwire.bitstream.limits import MAX_ELEMENTS
from splatwire.codec.tiers import assign_stream_packets
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.ops.arrays import to_arrays
from splatwire.types import AnchorScene, Cameras, ReceivedScene


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """Complete scene and its division into packets, for simulating packet losses.

    Attributes:
        complete: The complete scene as a decoder returns it.
        members: Indices of the anchors in each packet.
        cameras: Cameras of the pictures for the training of a concealer; converted to coordinates relative to the
            origin of the scene. None to train without pictures.
    """

    complete: ReceivedScene[AnchorScene]
    members: PacketMembers
    cameras: Cameras | None = None

    def __post_init__(self) -> None:
        if self.cameras is not None:
            object.__setattr__(self, "cameras", self.cameras.relative_to(self.complete.scene.origin))

    @property
    def scene(self) -> AnchorScene:
        """The complete scene, without packet loss."""
        return self.complete.scene

    def pseudo_losses(self, rates: Sequence[float], seed: int | np.random.SeedSequence) -> list[Bool[np.ndarray, "N"]]:
        """Simulates packet losses, one for each rate; returns the masks of received anchors, bool (N) each.

        Args:
            rates: Share of the packets that is lost, 0 to 1, in each simulation.
            seed: Seed of the random choices.
        """
        seeds = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        each = zip(rates, seeds.generate_state(len(rates)).tolist(), strict=True)
        return [pseudo_loss(self.members, self.complete.scene.num_elements, rate, number) for rate, number in each]


@checked
def calibration_data(
    stream: SceneStream, complete: ReceivedScene[AnchorScene], cameras: Cameras | None = None
) -> CalibrationData:
    """Prepares a scene for a calibration with simulated packet losses.

    Args:
        stream: The complete stream.
        complete: The decoded scene.
        cameras: Cameras of the pictures for the training of a concealer; None to train without pictures.

    Raises:
        InvalidValueError: If a packet was lost, or the stream has fewer than two packets.
    """
    members = assign_stream_packets(stream).members
    if complete.loss_mask.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(members.starts) < 3:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    return CalibrationData(to_arrays(complete), members, cameras)


@checked
def dropped_packets(count: int, rate: float, seed: int) -> list[int]:
    """Returns the indices of `rate * count` randomly chosen packets to drop.

    Of two or more packets, at least one is dropped and at least one is kept. A single packet is kept.

    Raises:
        InvalidValueError: If an argument is out of range.
    """
    whole_number(count, "count", 1, MAX_ELEMENTS)
    whole_number(seed, "seed")
    if not 0 <= rate <= 1:
        raise InvalidValueError(f"rate must be from 0 to 1, not {shown(rate)}")
    return np.random.default_rng(seed).permutation(count)[: min(max(round(rate * count), 1), count - 1)].tolist()


@checked
def pseudo_loss(members: PacketMembers, num_anchors: int, rate: float, seed: int) -> Bool[np.ndarray, "N"]:
    """Simulates the loss of a random share of the packets; returns the mask of received anchors.

    Args:
        members: Anchors of each packet.
        num_anchors: Number of anchors of the scene, N.
        rate: Share of the packets that is lost, 0 to 1.
        seed: Seed of the random choice.
    """
    count = len(members.starts) - 1
    fully_received = np.ones(whole_number(num_anchors, "num_anchors", len(members.indices), MAX_ELEMENTS), np.bool_)
    for packet in dropped_packets(count, rate, seed):
        fully_received[members.indices[members.starts[packet] : members.starts[packet + 1]]] = False
    return fully_received
