"""Frames in, packets out."""

import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from splatwire.byte_io import ByteWriter
from splatwire.clips.extent import Ball, ball_of
from splatwire.clips.frames import Frame
from splatwire.clips.gathering import Gathering, group_of
from splatwire.clips.grouping import NamedFrame
from splatwire.clips.options import USUAL, ClipOptions
from splatwire.clips.tracking import SECTION, Tracker, TrackingReport
from splatwire.codec.antialiasing import SECTION as ANTIALIASING
from splatwire.codec.antialiasing import antialiasing_sections
from splatwire.codec.origin import origin_sections, read_origin
from splatwire.codec.schemas.gaussians.quality import quality_of
from splatwire.codec.schemas.tracks.encoder import ClipWriter
from splatwire.codec.schemas.tracks.track_group import TrackGroup
from splatwire.codec.viewpoint import EXTENT_SECTION, extent_section, up_sections
from splatwire.errors import InvalidValueError
from splatwire.model import SplatScene
from splatwire.ops.threads import allowed_threads
from splatwire.packets import Manifest, Packet, SceneStream
from splatwire.render.precision import precision_classes
from splatwire.render.up import up_of
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
FIRST_FRAME = "first_frame"
"""Section of a clip that goes on where another one ended: the number of its first frame, LEB128."""
KNOWN_SHARE = 0.5
"""Of the Gaussians: where so many have a class of precision from before, the others get a middle one."""
ANEW, APART = 0.5, 0.5
"""Shares: of a frame's Gaussians, of which so many were not there before where it shows another scene; and of the first
frames, of which so many show another one where frames are coded one by one."""
SEEN = 0.02
"""A change of a coefficient of the harmonics that is told, where an eye sees 1 as the whole range of a colour."""


class ClipEncoder:
    """Encodes frames as they come; holds those of one group, whatever the length of the clip.

    Args:
        options: How.
        classes: Classes of precision of Gaussians that are seen first; None looks at them from all sides
            (`splatwire.render.precision`).
        live: Whether somebody waits for the last frame of a group: then more is done before, and all in all. It changes
            no bit but of how precise they are who come later, with a scene that is another one.
    """

    def __init__(
        self, options: ClipOptions = USUAL, classes: Callable[[Splats], np.ndarray] | None = None, *,
        live: bool = False,
    ) -> None:  # fmt: skip
        self._options, self._classes, self._live = options, classes or precision_classes, live
        self._tracker, self._frames = Tracker(options.order), Gathering(options.group_frames)
        self._ended: tuple[NamedFrame, NamedFrame] | None = None
        self._last: Splats | None = None
        self._degree: int | None = None
        self._groups, self._told = 0, False
        self._sections: dict[str, bytes] = {}
        self._num_frames = self._first_frame = 0
        self._extent: Ball | None = None
        self._known: tuple[np.ndarray, np.ndarray] | None = None
        self._newest = -1
        self._writer = self._new_writer()

    def _new_writer(self) -> ClipWriter:
        options = self._options
        return ClipWriter(
            options.rate, options.group_frames, quality_of(options.quality), options.background,
            threads=options.threads or allowed_threads(),
        )  # fmt: skip

    @property
    def tracking(self) -> TrackingReport:
        """How the frames so far belong together."""
        return self._tracker.report

    def next_chapter(self) -> "ClipEncoder":
        """An encoder of a clip of its own that goes on where this one ends, in which Gaussians keep their names.

        What this one holds is not held by it.
        """
        assert not self._frames
        self._catch_up()
        other = ClipEncoder(self._options, self._classes, live=self._live)
        other._tracker, other._degree, other._told = self._tracker, self._degree, self._told
        other._first_frame = other._num_frames = self._num_frames
        number = ByteWriter()
        number.unsigned(self._num_frames)
        other._sections = {**self._sections, FIRST_FRAME: number.bytes()}
        names = self._tracker.rename()
        if self._known is not None:
            _, there, at = np.intersect1d(names, self._known[0], assume_unique=True, return_indices=True)
            other._known = there, self._known[1][at]
        return other

    def restarted(self, first_frame: int) -> "ClipEncoder":
        """An encoder of a clip of its own that shares nothing with this one but its options and its upward direction.

        Args:
            first_frame: Number of its first frame.
        """
        other = ClipEncoder(self._options, self._classes, live=self._live)
        other._first_frame = other._num_frames = first_frame
        other._told = self._told
        other._sections = {name: data for name, data in self._sections.items() if name != ANTIALIASING}
        number = ByteWriter()
        number.unsigned(first_frame)
        if first_frame:
            other._sections[FIRST_FRAME] = number.bytes()
        return other

    def push(self, frame: Frame | Splats) -> list[Packet]:
        """Takes the next frame.

        Returns:
            The packets of its group if it is the last of one, of no stream yet, what is seen most first; else none.

        Raises:
            InvalidValueError: If its harmonics have another degree than those before, or it does not fit the order.
        """
        self._catch_up()
        taken = frame if isinstance(frame, Frame) else Frame.of(frame)
        if self._degree not in (None, taken.splats.degree):
            raise InvalidValueError(
                f"a frame has harmonics of degree {taken.splats.degree}, those before of {self._degree}"
            )
        if self._degree is None:
            self._sections |= {**antialiasing_sections(taken.antialiased), **origin_sections(taken.origin)}
        taken = taken.relative_to(read_origin(self._sections))
        self._degree = taken.splats.degree
        self._last = taken.splats
        self._frames.add(self._tracker.add(taken))
        self._num_frames += 1
        if len(self._frames) == self._options.group_frames:
            return self._flush()
        if self._live and 2 * len(self._frames) > self._options.group_frames:  # before, receivers have the one before
            self._writer.look(*self._frames.so_far())
        self._catch_up()
        return []

    def finish(self) -> SceneStream:
        """Ends the clip; the stream of all that was pushed.

        Raises:
            InvalidValueError: If nothing was.
        """
        self.flush()
        self._catch_up()
        if not self._groups:
            raise InvalidValueError("a clip has one frame at least")
        extent = self._extent  # of a clip that goes on nobody knows it
        where = {EXTENT_SECTION: extent_section(extent.middle, extent.radius)} if extent and extent.radius > 0 else {}
        return self._writer.finish({**self._stated, **where})

    def so_far(self, stream_id: int) -> tuple[Manifest, bytes]:
        """Manifest and side information of the groups so far, of a stream whose id was chosen before its end."""
        return self._writer.so_far(self._stated, stream_id)

    @property
    def _stated(self) -> dict[str, bytes]:
        return {SECTION: self.tracking.section(), **self._sections}

    def worth(self, packets: Sequence[Packet]) -> list[float]:
        """What losing each of some packets of the last group costs, see `splatwire.clips.worth.worth_of`."""
        return [self._writer.worth[packet.id] for packet in packets]

    def flush(self) -> list[Packet]:
        """Ends the group that frames are being gathered for, which is the last one: packets of what there is."""
        return self._flush() if self._frames else []

    def _flush(self) -> list[Packet]:
        group, frames = self._grouped(), self._frames.frames
        self._ended = frames[0], frames[-1]
        new = group.keys > self._newest
        self._newest = max(self._newest, int(group.keys[-1]) if len(group.keys) else -1)
        scenes = _scenes(group, frames, new)
        classes = self._precision(group, scenes, new)
        apart = len(frames) > 1 and len(frames[0].keys) > 0 and len(scenes) > APART * len(frames)
        first, smooth, self._groups = not self._groups, self._live and self._frames.smooth, self._groups + 1
        if first and apart and not self._live:
            assert classes is not None
            return self._one_by_one(group, frames, scenes, classes)
        self._frames = Gathering(self._options.group_frames, smooth=smooth)
        return self._writer.add(group, classes)

    def _grouped(self) -> TrackGroup:
        """The group of all frames; where those go who are not there in all is found beside what the others do."""
        if len(self._frames) < self._options.group_frames:
            return self._frames.group()
        with ThreadPoolExecutor(1) as pool:
            looked = pool.submit(self._writer.look, *self._frames.so_far())
            group = self._frames.group()
            looked.result()
        return group

    def _one_by_one(
        self, group: TrackGroup, frames: list[NamedFrame], scenes: list[int], classes: np.ndarray
    ) -> list[Packet]:
        """The first frames, most of which show another scene than the one before: each is a group, and so is the rest.

        Lattice, steps and tables are those of all of them.
        """
        self._options = replace(self._options, group_frames=1)
        self._writer, self._frames = self._new_writer(), Gathering(1)
        self._writer.fit(group.first(np.arange(len(group.keys))), classes)
        LOG.warning(
            "%d of the first %d frames show another scene than the one before: each frame is a group", len(scenes),
            len(frames),
        )  # fmt: skip
        packets = []
        for frame in frames:
            own = group_of([frame])
            packets += self._writer.add(own, classes[np.searchsorted(group.keys, own.keys)])
        return packets

    def _precision(self, group: TrackGroup, scenes: list[int], new: np.ndarray) -> np.ndarray | None:
        """Classes of precision of a group's tracks; None where nobody looks: who comes later is as precise as most.

        Whoever comes with another scene is looked at, and who comes after.

        Args:
            group: The tracks.
            scenes: See `_scenes`.
            new: Which tracks were not in a group before, bool (n).
        """
        if not scenes or (self._live and self._groups):  # looking takes longer than somebody waits
            return None
        classes = self._usual(len(group.keys))
        if not self._groups and self._known is not None:
            _, here, at = np.intersect1d(group.keys, self._known[0], assume_unique=True, return_indices=True)
            if len(here) >= KNOWN_SHARE * len(group.keys):
                classes[here] = self._known[1][at]
                return classes
        scene = np.where(new, np.searchsorted(scenes, group.begins, side="right") - 1, -1)
        for number in range(len(scenes)):
            some = np.flatnonzero(scene == number)
            first = group.first(some)
            classes[some] = self._classes(first)
            if not number and not self._groups and not self._first_frame:
                up = self._options.up
                self._sections |= up_sections(up_of(SplatScene(first)) if up == "auto" else up)
        self._known = group.keys, classes
        return classes

    def _usual(self, count: int) -> np.ndarray:
        """The middle one of the classes of precision that are known."""
        return np.full(count, int(np.median(self._known[1])) if self._known else 0, np.int8)

    def _catch_up(self) -> None:
        """Looks at the frame before, and at the group that ended with it: no packet waits for that."""
        ball = None if self._last is None else ball_of(self._last)
        self._extent, self._last = self._extent.with_(ball) if self._extent and ball else self._extent or ball, None
        self._tell_harmonics()

    def _tell_harmonics(self) -> None:
        """Warns, once, where colours change with the direction that they are seen from: tracks keep those of birth."""
        (first, last), self._ended = self._ended or (None, None), None
        if first is None or last is None or self._told or not self._degree:
            return
        _, here, there = np.intersect1d(first.keys, last.keys, assume_unique=True, return_indices=True)
        before, after = first.splats.sh[here, 1:], last.splats.sh[there, 1:]
        changed = int((np.abs(before - after) > SEEN).any(axis=(1, 2)).sum())
        if changed:
            self._told = True
            LOG.warning(
                "harmonics above degree 0 of %s of %s Gaussians change from frame to frame: a clip keeps those of the "
                "first frame that each is in", f"{changed:,}", f"{len(here):,}",
            )  # fmt: skip


def _scenes(group: TrackGroup, frames: Sequence[NamedFrame], new: np.ndarray) -> list[int]:
    """Frames of a group that show another scene than the one before, as the first one does."""
    born = np.bincount(group.begins[new], minlength=len(frames))
    return [n for n, frame in enumerate(frames) if born[n] > ANEW * len(frame.keys)]


def encode_clip(
    frames: Iterable[Frame | Splats],
    options: ClipOptions = USUAL,
    *,
    progress: Callable[[int], None] | None = None,
) -> tuple[SceneStream, TrackingReport]:
    """Encodes frames that are all there.

    Args:
        frames: They, in order.
        options: How.
        progress: Called with the number of frames that are done.

    Raises:
        InvalidValueError: See `ClipEncoder`.
    """
    encoder = ClipEncoder(options)
    for number, frame in enumerate(frames):
        encoder.push(frame)
        if progress:
            progress(number + 1)
    return encoder.finish(), encoder.tracking
