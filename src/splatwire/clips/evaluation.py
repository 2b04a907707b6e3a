"""How well a clip survives losses: frame by frame against renders of its own frames, and how much it flickers."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.channel import LossModel
from splatwire.channel.transmit import arrival_groups, draw_mask
from splatwire.clips.concealers import clip_concealer
from splatwire.clips.decoding import ClipFrame, decode_frames
from splatwire.clips.frames import Frame
from splatwire.codec import decode_stream
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr
from splatwire.model import SplatScene
from splatwire.packets import SceneStream
from splatwire.render import iterate_views
from splatwire.scene import Cameras

NUM_VIEWS, VIEW_SIZE = 4, 320
"""Views around the first frame where nobody names cameras, and their width and height in pixels."""


@dataclass(frozen=True)
class ClipRow:
    """One way in which a clip arrives and is shown.

    Attributes:
        concealer: What becomes of tracks whose motion was lost.
        loss: What is lost; None shows the stream as it is.
        seed: Seed of the loss.
        told: What reports call the loss, such as `bernoulli:0.2`; empty for none.
    """

    concealer: str
    loss: LossModel | None = None
    seed: int = 0
    told: str = ""


@dataclass(frozen=True, eq=False)
class ClipScore:
    """What became of a clip.

    Attributes:
        row: How it arrived.
        psnr: Of each frame against its own render, decibels, mean over views, float64 (F).
        change: Mean square of what a picture changes from the frame before less what the reference does, mean over
            views, float64 (F - 1).
        later: The first frame of the second group, or 0 if there is none: a first group is apart, since nothing was
            there before it.
        num_lost: Packets that did not come in time.
    """

    row: ClipRow
    psnr: np.ndarray
    change: np.ndarray
    later: int
    num_lost: int

    @property
    def mean(self) -> float:
        """PSNR, mean over frames from the second group on, decibels."""
        return float(self.psnr[self.later :].mean())

    @property
    def flicker(self) -> float:
        """`change`, mean over frames from the second group on."""
        return float(self.change[self.later :].mean()) if len(self.change) > self.later else 0.0

    def worst_below(self, complete: "ClipScore") -> float:
        """How far the worst frame from the second group on is below the same frame of another score, decibels."""
        return float(self._below(complete).max())

    def mean_below(self, complete: "ClipScore") -> float:
        """How far frames from the second group on are below those of another score, mean, decibels."""
        return float(self._below(complete).mean())

    def _below(self, complete: "ClipScore") -> np.ndarray:
        """Of each frame; 0 where both are the same, infinite ones too (they equal the reference)."""
        own, other = self.psnr[self.later :], complete.psnr[self.later :]
        differ = own != other
        return np.subtract(other, own, out=np.zeros_like(own), where=differ)


OnPicture = Callable[[int, int, Float[np.ndarray, "H W 3"]], None]
"""Called with row (-1 for the reference), frame and picture of the first view."""


def score_clip(
    stream: SceneStream, frames: Iterable[Frame], cameras: Cameras, rows: Sequence[ClipRow], *,
    renderer: str = "cpu", on_picture: OnPicture | None = None, progress: Callable[[int], None] | None = None,
) -> list[ClipScore]:  # fmt: skip
    """Shows a clip in several ways at once, frame by frame: what is held is a group of each.

    Args:
        stream: The clip.
        frames: What was encoded, in order.
        cameras: Where they are looked at from.
        rows: How it arrives and is shown.
        renderer: Name of the renderer.
        on_picture: Gets the pictures of the first view.
        progress: Called with the number of frames that are done.

    Raises:
        InvalidValueError: If there are not as many frames as the clip has.
        UnknownNameError: If there is no such concealer or renderer.
    """
    arrived = [_Arrived(stream, row) for row in rows]
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
        ClipScore(row, np.array(m.psnr), np.array(m.change), later if later < count else 0, a.num_lost)
        for row, m, a in zip(rows, meter, arrived, strict=True)
    ]


def frame_psnr(pictures: Float[np.ndarray, "V H W 3"], reference: Float[np.ndarray, "V H W 3"]) -> float:
    """PSNR of a frame, mean over views, decibels; a view that sees nothing of this frame says nothing of it."""
    views = psnr(pictures, reference)
    unlike = views[np.isfinite(views)]
    return float((unlike if len(unlike) else views).mean())


class _Arrived:
    """A clip as it arrives in one row."""

    def __init__(self, stream: SceneStream, row: ClipRow) -> None:
        self._concealer, self._there = clip_concealer(row.concealer), None
        came = stream
        self.num_lost = stream.manifest.num_packets - len(stream.packets)
        if row.loss is not None:
            mask = draw_mask(stream, row.loss, seed=row.seed)
            when = arrival_groups(stream, mask, row.loss, seed=row.seed)
            came = stream.with_packets(p for p, group in zip(stream.packets, when.tolist(), strict=True) if group >= 0)
            self.num_lost += int((~mask.received).sum())
            self._there = there_by_group(stream, when)
        self._clip = decode_stream(came).scene
        self.timeline, self.background = self._clip.timeline, self._clip.background

    def frames(self) -> Iterator[ClipFrame]:
        return decode_frames(self._clip, self._concealer, there=self._there)


def there_by_group(stream: SceneStream, arrival: np.ndarray) -> Callable[[int], np.ndarray]:
    """Which bases are there in a group's time.

    Args:
        stream: The complete clip.
        arrival: Group in whose time each packet arrives, -1 for never, int64.

    Returns:
        What gives bool (T) for a group.
    """
    plan = stream.manifest.plan
    starts: dict[int, int] = {}
    count = 0
    for span in plan.spans[::2]:
        for block in range(span.num_blocks):
            starts[span.first_block + block] = count + block * span.block_size
        count += span.num_elements
    never = len(plan.spans)
    group = np.full(count, never, np.int64)
    for packet, when in zip(stream.packets, arrival.tolist(), strict=True):
        if packet.id.block in starts and when >= 0:
            first = starts[packet.id.block] + packet.id.lane
            group[first : first + packet.num_elements] = when
    return lambda wanted: group <= wanted


class _Meter:
    """What is measured of the pictures of a row, one frame after another."""

    def __init__(self) -> None:
        self.psnr: list[float] = []
        self.change: list[float] = []
        self._before: np.ndarray | None = None

    def add(self, pictures: Float[np.ndarray, "V H W 3"], reference: Float[np.ndarray, "V H W 3"]) -> None:
        self.psnr.append(frame_psnr(pictures, reference))
        error = pictures - reference  # its change is the picture's change less the reference's
        if self._before is not None:
            self.change.append(float(((error - self._before) ** 2).mean()))
        self._before = error


def _pictures(scene: SplatScene, cameras: Cameras, renderer: str) -> Float[np.ndarray, "V H W 3"]:
    return np.stack(list(iterate_views(scene, cameras, renderer=renderer)))
