"""Image quality of sequences with losses: PSNR per frame against renders of the original frames, and flicker."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.bitstream import SceneStream
from splatwire.channel import LossModel
from splatwire.channel.transmit import arrival_groups, draw_mask
from splatwire.codec import decode_stream
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr
from splatwire.render import iterate_views
from splatwire.sequence.decoding import SequenceFrame, decode_frames
from splatwire.sequence.frames import Frame
from splatwire.types import Cameras, SplatScene

NUM_VIEWS, VIEW_SIZE = 4, 320
"""Number of views around the first frame if no cameras are given, and their width and height in pixels."""


@dataclass(frozen=True)
class SequenceRow:
    """Experiment on a sequence: loss model, seed of the loss, and concealer of lost motion.

    Attributes:
        concealer: Name of the concealer of lost motion.
        loss: Loss model; None for the complete stream.
        seed: Seed of the loss.
        loss_label: Label of the loss model in reports, such as `bernoulli:0.2`; empty for the complete stream.
    """

    concealer: str
    loss: LossModel | None = None
    seed: int = 0
    loss_label: str = ""


@dataclass(frozen=True, eq=False)
class SequenceScore:
    """Image quality of a sequence in one experiment (loss model and concealer).

    Properties such as `mean` and `flicker` leave out the first group of pictures (GOP).

    Attributes:
        row: The loss model and the concealer.
        psnr: PSNR of each frame against the render of the original frame, mean over views, decibels, float64 (F).
        change: Flicker between each frame and the next, float64 (F - 1). The error of a frame is the rendered minus the
            original picture. The flicker is the mean square of the difference between the errors of the two frames.
        later: Index of the first frame after the first GOP.
        num_lost: Number of packets that were lost or late.
    """

    # In the first GOP, a concealer has no earlier frames to use.

    row: SequenceRow
    psnr: np.ndarray
    change: np.ndarray
    later: int
    num_lost: int

    @property
    def mean(self) -> float:
        """Mean PSNR over the frames after the first group of pictures, decibels."""
        return float(self.psnr[self.later :].mean())

    @property
    def flicker(self) -> float:
        """Mean flicker over the frames after the first group of pictures."""
        return float(self.change[self.later :].mean()) if len(self.change) > self.later else 0.0

    def worst_below(self, complete: "SequenceScore") -> float:
        """Returns the largest decrease in the PSNR of a frame that packet losses cause, in decibels.

        Args:
            complete: Score of the sequence without losses.
        """
        return float(self._below(complete).max())

    def mean_below(self, complete: "SequenceScore") -> float:
        """Returns the mean decrease in the PSNR of a frame that packet losses cause, in decibels.

        Args:
            complete: Score of the sequence without losses.
        """
        return float(self._below(complete).mean())

    def _below(self, complete: "SequenceScore") -> np.ndarray:
        """Returns by how many decibels packet losses lower the PSNR of each frame.

        Frames of the first group of pictures are left out.
        """
        # Frames with equal PSNR have difference 0, even if the PSNR is infinite.
        own, other = self.psnr[self.later :], complete.psnr[self.later :]
        differ = own != other
        return np.subtract(other, own, out=np.zeros_like(own), where=differ)


OnPicture = Callable[[int, int, Float[np.ndarray, "H W 3"]], None]
"""Called with the index of the configuration (-1 for the reference), the frame number and the image of the first
view."""


def score_sequence(
    stream: SceneStream, frames: Iterable[Frame], cameras: Cameras, rows: Sequence[SequenceRow], *,
    renderer: str = "cpu", on_picture: OnPicture | None = None, progress: Callable[[int], None] | None = None,
) -> list[SequenceScore]:  # fmt: skip
    """Measures the image quality of a sequence under several losses and concealers, in one pass over the frames.

    Args:
        stream: Stream of the sequence.
        frames: The original frames, in order.
        cameras: Cameras of the evaluation.
        rows: Experiments: each has a loss model and a concealer.
        renderer: Name of the renderer.
        on_picture: Receives the images of the first view.
        progress: Called with the number of finished frames.

    Raises:
        InvalidValueError: If the numbers of frames differ.
        UnknownNameError: If the concealer or renderer does not exist.
    """
    arrived = [_ReceivedSequence(stream, row) for row in rows]
    shown = [a.frames() for a in arrived]
    meter = [_Meter() for _ in rows]
    count = arrived[0].timeline.num_frames
    for number, frame in enumerate(frames):
        if number >= count:
            raise InvalidValueError(f"the clip has {count} frames, the reference more")
        own = frame.scene(arrived[0].background)
        reference = _pictures(own, cameras, renderer)
        if on_picture:
            on_picture(-1, number, reference[0])
        for index, stream_of_frames in enumerate(shown):
            pictures = _pictures(next(stream_of_frames).scene, cameras, renderer)
            meter[index].add(pictures, reference)
            if on_picture:
                on_picture(index, number, pictures[0])
        if progress:
            progress(number + 1)
    if len(meter[0].psnr) != count:
        raise InvalidValueError(f"the clip has {count} frames, the reference {len(meter[0].psnr)}")
    later = arrived[0].timeline.group_frames
    return [
        SequenceScore(row, np.array(m.psnr), np.array(m.change), later if later < count else 0, a.num_lost)
        for row, m, a in zip(rows, meter, arrived, strict=True)
    ]


def frame_psnr(pictures: Float[np.ndarray, "V H W 3"], reference: Float[np.ndarray, "V H W 3"]) -> float:
    """Mean PSNR of a frame, decibels, over the views that differ from their reference."""
    views = psnr(pictures, reference)
    unlike = views[np.isfinite(views)]
    return float((unlike if len(unlike) else views).mean())


class _ReceivedSequence:
    """Simulates the packet loss of one experiment, then decodes and conceals what was received."""

    def __init__(self, stream: SceneStream, row: SequenceRow) -> None:
        self._concealer, self._available = temporal_concealer(row.concealer), None
        arrived = stream
        self.num_lost = stream.manifest.num_packets - len(stream.packets)
        if row.loss is not None:
            mask = draw_mask(stream, row.loss, seed=row.seed)
            when = arrival_groups(stream, mask, row.loss, seed=row.seed)
            arrived = stream.with_packets(
                p for p, group in zip(stream.packets, when.tolist(), strict=True) if group >= 0
            )
            self.num_lost += int((~mask.received).sum())
            self._available = available_by_group(stream, when)
        self._encoder = decode_stream(arrived).scene
        self.timeline, self.background = self._encoder.timeline, self._encoder.background

    def frames(self) -> Iterator[SequenceFrame]:
        return decode_frames(self._encoder, self._concealer, available=self._available)


def available_by_group(stream: SceneStream, arrival: np.ndarray) -> Callable[[int], np.ndarray]:
    """Returns a function that finds the keyframe Gaussians received before a group of pictures is displayed.

    Args:
        stream: The complete stream.
        arrival: Index of the group of pictures during which each packet arrives, int64; -1 for packets that never
            arrive.

    Returns:
        Function that maps the index of a group of pictures to the mask of received keyframe Gaussians, bool (T).
    """
    plan = stream.manifest.plan
    starts: dict[int, int] = {}
    count = 0
    for keyframes, _ in plan.gop_spans:
        for n, block in enumerate(keyframes.blocks):
            starts[block] = count + n * keyframes.block_size
        count += keyframes.num_elements
    never = len(plan.gop_spans)
    group = np.full(count, never, np.int64)
    for packet, when in zip(stream.packets, arrival.tolist(), strict=True):
        if packet.id.block in starts and when >= 0:
            first = starts[packet.id.block] + packet.id.index_in_block
            group[first : first + packet.num_elements] = when
    return lambda wanted: group <= wanted


class _Meter:
    """Accumulates the PSNR and the flicker of one experiment, frame by frame."""

    def __init__(self) -> None:
        self.psnr: list[float] = []
        self.change: list[float] = []
        self._before: np.ndarray | None = None

    def add(self, pictures: Float[np.ndarray, "V H W 3"], reference: Float[np.ndarray, "V H W 3"]) -> None:
        self.psnr.append(frame_psnr(pictures, reference))
        error = pictures - reference  # its change is the image's change minus the reference's
        if self._before is not None:
            self.change.append(float(((error - self._before) ** 2).mean()))
        self._before = error


def _pictures(scene: SplatScene, cameras: Cameras, renderer: str) -> Float[np.ndarray, "V H W 3"]:
    return np.stack(list(iterate_views(scene, cameras, renderer=renderer)))
