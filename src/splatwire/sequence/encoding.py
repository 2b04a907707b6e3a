"""Encoder of sequences: frames in, packets out."""

import logging
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import Manifest, Packet, SceneStream
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.antialiasing import SECTION as ANTIALIASING
from splatwire.codec.antialiasing import antialiasing_sections
from splatwire.codec.gaussians.quality import quality_of
from splatwire.codec.initial_view import EXTENT_SECTION, UP_SECTION, extent_section, up_sections
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.codec.metadata import metadata_sections
from splatwire.codec.sequence.encoder import TracksEncoder
from splatwire.codec.sequence.track_group import TrackGroup
from splatwire.errors import InvalidValueError
from splatwire.files.byte_io import ByteWriter
from splatwire.io.formats.content import coarse_positions
from splatwire.ops.threads import allowed_threads
from splatwire.render.precision import measure_class_offsets
from splatwire.render.up import estimate_up_axis
from splatwire.sequence.extent import BoundingSphere, bounding_sphere
from splatwire.sequence.frames import Frame
from splatwire.sequence.group_builder import GroupBuilder, group_of
from splatwire.sequence.options import DEFAULT_OPTIONS, SequenceOptions
from splatwire.sequence.partial_tracks import TrackedFrame
from splatwire.sequence.tracking import SECTION as TRACKING
from splatwire.sequence.tracking import Tracker, TrackingReport
from splatwire.types import SplatScene
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin, describe_origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
FIRST_FRAME = "first_frame"
"""Side information section with the number of the first frame (LEB128), for a sequence that continues another
sequence."""
MIN_CLASSIFIED_SHARE = 0.5
"""Minimum fraction of Gaussians with a precision class, for giving other Gaussians the median class without an
analysis."""
MIN_NEW_SHARE = 0.5
"""Minimum fraction of new Gaussians for a frame to count as a scene cut."""
MIN_CUT_SHARE = 0.5
"""Minimum fraction of scene cuts in the first group for encoding every frame as its own group of pictures."""
MIN_VISIBLE_CHANGE = 0.02
"""Minimum change of a harmonic coefficient that triggers a warning; 1 is the full range of a colour."""


class SequenceEncoder:
    """Encoder of sequences that takes one frame at a time and keeps one group of pictures in memory.

    Args:
        options: Encoder options.
        choose_class_offsets: Function that returns the class offset of each new Gaussian, as `measure_class_offsets`
            does. None for `measure_class_offsets`.
        live: True to encode with less delay, at a higher total processing cost. Scene cuts then begin no new shot,
            frames never become groups of their own, and Gaussians that are new after the first group get a default
            precision class.
    """

    @checked
    def __init__(
        self, options: SequenceOptions = DEFAULT_OPTIONS,
        choose_class_offsets: Callable[[Splats], np.ndarray] | None = None, *,
        live: bool = False,
    ) -> None:  # fmt: skip
        self._options, self._live = options, live
        self._choose_class_offsets = choose_class_offsets or measure_class_offsets
        self._tracker, self._group_builder = Tracker(options.order), GroupBuilder(options.group_frames)
        # first and last frame of the newest group, which wait for the comparison of harmonics
        self._frames_to_compare: tuple[TrackedFrame, TrackedFrame] | None = None
        self._last_splats: Splats | None = None
        self._degree: int | None = None
        self._num_groups, self._warned_of_harmonics = 0, False
        self._warned_kinds: set[str] = set()
        self._sections: dict[str, bytes] = {}
        self._num_frames = self._first_frame_number = 0
        self._is_origin_open = True  # until a frame is visible; in a live sequence, at most until the first group ends
        self._view: tuple[SceneMetadata, Origin] = NO_METADATA, NO_ORIGIN  # initial view, and the origin of its points
        self._extent: BoundingSphere | None = None
        self._known_class_offsets: tuple[np.ndarray, np.ndarray] | None = None
        self._newest_key = -1
        self._tracks_encoder = self._new_tracks_encoder()

    def _new_tracks_encoder(self) -> TracksEncoder:
        options = self._options
        return TracksEncoder(
            Fraction(options.rate), options.group_frames, quality_of(options.quality), options.background,
            threads=options.threads or allowed_threads(),
        )  # fmt: skip

    @property
    def tracking(self) -> TrackingReport:
        """Statistics on matching each Gaussian to the same Gaussian in the previous frame."""
        return self._tracker.report

    def new_period(self) -> "SequenceEncoder":
        """Returns an encoder that continues the sequence as a new, independent stream.

        The new encoder matches the Gaussians of its first frame with the Gaussians of this encoder's last frame.
        """
        assert not self._group_builder
        self._finish_deferred_work()
        other = SequenceEncoder(self._options, self._choose_class_offsets, live=self._live)
        other._tracker, other._degree, other._warned_of_harmonics = (
            self._tracker,
            self._degree,
            self._warned_of_harmonics,
        )
        other._warned_kinds = self._warned_kinds
        other._is_origin_open, other._view = self._is_origin_open, self._view
        other._first_frame_number = other._num_frames = self._num_frames
        number = ByteWriter()
        number.unsigned(self._num_frames)
        other._sections = {**self._sections, FIRST_FRAME: number.bytes()}
        old_keys = self._tracker.renumber()
        if self._known_class_offsets is not None:
            _, new_keys, rows = np.intersect1d(
                old_keys, self._known_class_offsets[0], assume_unique=True, return_indices=True
            )
            other._known_class_offsets = new_keys, self._known_class_offsets[1][rows]
        return other

    def restarted(self, first_frame: int) -> "SequenceEncoder":
        """Returns a new encoder for an independent stream, with the same options.

        Args:
            first_frame: Number of the first frame of the new encoder.
        """
        other = SequenceEncoder(self._options, self._choose_class_offsets, live=self._live)
        other._first_frame_number = other._num_frames = first_frame
        other._warned_of_harmonics, other._warned_kinds = self._warned_of_harmonics, self._warned_kinds
        other._view = self._view
        # The next frame states its antialiasing and origin.
        other._sections = {name: data for name, data in self._sections.items() if name != ANTIALIASING}
        number = ByteWriter()
        number.unsigned(first_frame)
        if first_frame:
            other._sections[FIRST_FRAME] = number.bytes()
        return other

    def push(self, frame: Frame | Splats) -> list[Packet]:
        """Adds the next frame, and encodes a group of pictures if this frame completes the group.

        Returns:
            Packets of the completed group in sending order; empty if no group is complete.

        Raises:
            InvalidValueError: If the degree of harmonics differs from that of earlier frames, or the number of
                Gaussians contradicts the option `order`.
        """
        self._finish_deferred_work()
        checked_frame = frame if isinstance(frame, Frame) else Frame.of(frame)
        checked_frame = replace(checked_frame, splats=checked_frame.splats.with_unit_quats())
        if self._degree not in (None, checked_frame.splats.degree):
            raise InvalidValueError(
                f"a frame has harmonics of degree {checked_frame.splats.degree}, those before of {self._degree}"
            )
        if self._degree is None:
            self._sections |= antialiasing_sections(checked_frame.antialiased)
            if checked_frame.metadata.view is not None:
                self._view = SceneMetadata(view=checked_frame.metadata.view), checked_frame.origin
            elif not checked_frame.fits_origin(self._view[1]):  # that of another place, before a restart
                self._view = NO_METADATA, NO_ORIGIN
            self._set_origin(checked_frame)
            self._sections |= metadata_sections(replace(checked_frame.metadata, view=None))
        origin = ORIGIN_SECTION.read(self._sections)
        if self._is_origin_open and not checked_frame.fits_origin(origin):
            self._set_origin(checked_frame)
            origin = checked_frame.origin
        self._is_origin_open &= not checked_frame.is_visible
        from_other_origin, checked_frame = checked_frame.origin != origin, checked_frame.relative_to(origin)
        self._warn_of_other_frame(checked_frame, from_other_origin=from_other_origin)
        self._degree = checked_frame.splats.degree
        self._last_splats = checked_frame.splats if checked_frame.is_visible else None
        self._group_builder.add(self._tracker.add(checked_frame))
        self._num_frames += 1
        if len(self._group_builder) == self._options.group_frames:
            return self._flush()
        # Not earlier: in the first half of a group, this work would delay sending the previous group.
        if self._live and 2 * len(self._group_builder) > self._options.group_frames:
            self._tracks_encoder.fit_early(*self._group_builder.tracks_so_far())
        self._finish_deferred_work()
        return []

    def _set_origin(self, frame: Frame) -> None:
        """Sets the origin of the sequence to that of a frame, and converts the initial view to it."""
        for name in (ORIGIN_SECTION.name, INITIAL_VIEW):
            self._sections.pop(name, None)
        metadata, origin = self._view
        self._sections |= ORIGIN_SECTION.sections(frame.origin)
        self._sections |= metadata_sections(metadata.moved_origin(origin, frame.origin))

    def _warn_of_other_frame(self, frame: Frame, *, from_other_origin: bool) -> None:
        """Logs a warning if a frame does not fit the first frame of the sequence.

        Two problems are reported, each once per sequence: the Gaussians are too far from the origin of the sequence for
        precise positions, or the antialiasing of the frame differs from that of the first frame.

        Args:
            frame: The frame, relative to the origin of the sequence.
            from_other_origin: True if the frame was converted from another origin.
        """
        is_new = from_other_origin and "position" not in self._warned_kinds
        if is_new and (coarse := coarse_positions(frame.splats.select(frame.drawn))) is not None:
            self._warned_kinds.add("position")
            LOG.warning(
                "frame %d: %.3g %% of the Gaussians are up to %.6g from the origin of the sequence (%s), where "
                "positions have steps of up to %.2g, more than half of their size: all frames lose precision: "
                "use coordinates relative to one point near all frames", self._num_frames, 100 * coarse[0], coarse[1],
                describe_origin(ORIGIN_SECTION.read(self._sections)), coarse[2],
            )  # fmt: skip
        is_antialiased = ANTIALIASING in self._sections
        if frame.antialiased != is_antialiased and "antialiasing" not in self._warned_kinds:
            self._warned_kinds.add("antialiasing")
            LOG.warning(
                "frame %d %s antialiased, the first one %s: all frames are drawn as the first one", self._num_frames,
                *(("is", "is not") if frame.antialiased else ("is not", "is")),
            )  # fmt: skip

    def finish(self) -> SceneStream:
        """Ends the sequence; returns the encoded stream of all frames.

        Raises:
            InvalidValueError: If no frame was added.
        """
        self.flush()
        self._finish_deferred_work()
        if not self._num_groups:
            raise InvalidValueError("a clip has one frame at least")
        extent = self._extent  # None if no frame has Gaussians
        sections = self._all_sections
        if extent and extent.radius > 0:
            sections[EXTENT_SECTION] = extent_section(extent.middle, extent.radius)
        return self._tracks_encoder.finish(sections)

    def current_header(self, stream_id: int) -> tuple[Manifest, bytes]:
        """Returns manifest and side information of the groups of pictures encoded so far.

        Args:
            stream_id: Id of the stream, for the manifest.
        """
        return self._tracks_encoder.current_header(self._all_sections, stream_id)

    def so_far(self, stream_id: int) -> tuple[Manifest, bytes]:
        """Deprecated name of `current_header`."""
        warnings.warn("SequenceEncoder.so_far is deprecated, use current_header", DeprecationWarning, stacklevel=2)
        return self.current_header(stream_id)

    @property
    def _all_sections(self) -> dict[str, bytes]:
        return {TRACKING: self.tracking.section(), **self._sections}

    def importance(self, packets: Sequence[Packet]) -> list[float]:
        """Returns the importance of packets of the last group of pictures.

        The importance is the visibility of new Gaussians (keyframe packets) or of moving tracks (motion packets).
        """
        return [self._tracks_encoder.importance[packet.id] for packet in packets]

    def flush(self) -> list[Packet]:
        """Encodes the frames of the incomplete last group of pictures, and returns the packets of this group."""
        return self._flush() if self._group_builder else []

    def _flush(self) -> list[Packet]:
        group, frames = self._collect_tracks(), self._group_builder.frames
        self._is_origin_open &= not self._live
        self._frames_to_compare = frames[0], frames[-1]
        new = group.keys > self._newest_key
        self._newest_key = max(self._newest_key, int(group.keys[-1]) if len(group.keys) else -1)
        cuts = _scene_cuts(group, frames, new)
        class_offsets = self._class_offsets_of(group, cuts, new)
        mostly_cuts = len(frames) > 1 and len(frames[0].keys) > 0 and len(cuts) > MIN_CUT_SHARE * len(frames)
        is_first_group, was_coherent, self._num_groups = (
            not self._num_groups,
            self._live and self._group_builder.is_coherent,
            self._num_groups + 1,
        )
        if is_first_group and mostly_cuts and not self._live:
            assert class_offsets is not None
            return self._encode_single_frames(group, frames, cuts, class_offsets)
        self._group_builder = GroupBuilder(self._options.group_frames, was_coherent=was_coherent)
        return self._tracks_encoder.add(group, class_offsets, cut=bool(cuts) and not self._live)

    def _collect_tracks(self) -> TrackGroup:
        """Joins the Gaussians of the current group of pictures to tracks. A track is one Gaussian over time."""
        if len(self._group_builder) < self._options.group_frames:
            return self._group_builder.group()
        # The analysis of the motion runs in parallel with the extrapolation of partial tracks.
        with ThreadPoolExecutor(1) as pool:
            analysis = pool.submit(self._tracks_encoder.fit_early, *self._group_builder.tracks_so_far())
            group = self._group_builder.group()
            analysis.result()
        return group

    def _encode_single_frames(
        self, group: TrackGroup, frames: list[TrackedFrame], cuts: list[int], class_offsets: np.ndarray
    ) -> list[Packet]:
        """Switches to groups of one frame, for a sequence with many scene cuts, and encodes the first frames.

        Args:
            group: Tracks of the first frames. A track is one Gaussian over time.
            frames: The first frames of the sequence, which would otherwise be encoded as one group of pictures.
            cuts: Indices of the frames that begin a new scene.
            class_offsets: Class offset of each track, (n): 0 for the finest quantisation steps, negative for coarser
                ones.

        Returns:
            Packets of the first frames.
        """
        self._options = replace(self._options, group_frames=1)
        self._tracks_encoder, self._group_builder = self._new_tracks_encoder(), GroupBuilder(1)
        LOG.warning(
            "%d of the first %d frames show another scene than the one before: each frame is a group", len(cuts),
            len(frames),
        )  # fmt: skip
        packets = []
        for number, frame in enumerate(frames):
            frame_group = group_of([frame])
            packets += self._tracks_encoder.add(
                frame_group, class_offsets[np.searchsorted(group.keys, frame_group.keys)], cut=number in cuts
            )
        return packets

    def _class_offsets_of(self, group: TrackGroup, cuts: list[int], new: np.ndarray) -> np.ndarray | None:
        """Chooses the precision class (set of quantisation steps) of each track in a group with a scene cut.

        A track is one Gaussian over time. The classes of new tracks that begin at or after the first cut are chosen by
        rendering. All other tracks get a default class. Nothing is rendered if this encoder continues another one
        (`new_period`) and knows the classes of most tracks of its first group.

        In the first group of a sequence, this function also adds the up axis to the side information, if
        the options name it or the frames do not state it.

        Args:
            group: Tracks of the group.
            cuts: Indices of the frames of the group that begin a new scene.
            new: Mask of tracks that are new in this group, bool (n).

        Returns:
            Class offset of each track, (n): 0 for the finest quantisation steps, negative for coarser ones. None if the
            group has no scene cut, or if it is a later group of a live sequence.
        """
        if not cuts or (self._live and self._num_groups):  # too slow for a live sequence
            return None
        class_offsets = self._default_class_offsets(len(group.keys))
        if not self._num_groups and self._known_class_offsets is not None:
            _, tracks, rows = np.intersect1d(
                group.keys, self._known_class_offsets[0], assume_unique=True, return_indices=True
            )
            if len(tracks) >= MIN_CLASSIFIED_SHARE * len(group.keys):
                class_offsets[tracks] = self._known_class_offsets[1][rows]
                return class_offsets
        cut_of_track = np.where(new, np.searchsorted(cuts, group.begins, side="right") - 1, -1)
        for number in range(len(cuts)):
            members = np.flatnonzero(cut_of_track == number)
            first = group.keyframe_gaussians(members)
            class_offsets[members] = self._choose_class_offsets(first)
            if not number and not self._num_groups and not self._first_frame_number:
                up = self._options.up
                if up != "auto":
                    self._sections.pop(UP_SECTION, None)
                    self._sections |= up_sections(up)
                elif not {UP_SECTION, INITIAL_VIEW} & set(self._sections):  # unless the frames state it
                    self._sections |= up_sections(estimate_up_axis(SplatScene(first)))
        self._known_class_offsets = group.keys, class_offsets
        return class_offsets

    def _default_class_offsets(self, count: int) -> np.ndarray:
        """Returns a default class offset for tracks: the median of the known offsets.

        Args:
            count: Number of tracks. A track is one Gaussian over time.

        Returns:
            The same class offset for each track, int8 (count); 0, the finest quantisation steps, if none is known yet.
        """
        return np.full(count, int(np.median(self._known_class_offsets[1])) if self._known_class_offsets else 0, np.int8)

    def _finish_deferred_work(self) -> None:
        """Adds the last frame to the extent of the scene, and checks the last group for changing colours.

        The packets do not depend on this work. If a frame completes a group, the work is deferred until the packets
        were returned, which shortens the delay of a live sequence.
        """
        sphere = None if self._last_splats is None else bounding_sphere(self._last_splats)
        self._extent = self._extent.union(sphere) if self._extent and sphere else self._extent or sphere
        self._last_splats = None
        self._warn_of_changing_harmonics()

    def _warn_of_changing_harmonics(self) -> None:
        """Logs a warning once if view-dependent colours change over time, because such changes are not coded."""
        (first, last), self._frames_to_compare = self._frames_to_compare or (None, None), None
        if first is None or last is None or self._warned_of_harmonics or not self._degree:
            return
        _, in_first, in_last = np.intersect1d(first.keys, last.keys, assume_unique=True, return_indices=True)
        before, after = first.splats.sh[in_first, 1:], last.splats.sh[in_last, 1:]
        changed = int((np.abs(before - after) > MIN_VISIBLE_CHANGE).any(axis=(1, 2)).sum())
        if changed:
            self._warned_of_harmonics = True
            LOG.warning(
                "harmonics above degree 0 of %s of %s Gaussians change from frame to frame: a clip keeps those of the "
                "first frame that each is in", f"{changed:,}", f"{len(in_first):,}",
            )  # fmt: skip


def _scene_cuts(group: TrackGroup, frames: Sequence[TrackedFrame], new: np.ndarray) -> list[int]:
    """Returns the indices of the frames with a scene cut within a group: frames in which most Gaussians are new."""
    born = np.bincount(group.begins[new], minlength=len(frames))
    return [n for n, frame in enumerate(frames) if born[n] > MIN_NEW_SHARE * len(frame.keys)]


@checked
def encode_sequence(
    frames: Iterable[Frame | Splats],
    options: SequenceOptions = DEFAULT_OPTIONS,
    *,
    progress: Callable[[int], None] | None = None,
) -> tuple[SceneStream, TrackingReport]:
    """Encodes a complete sequence.

    Args:
        frames: Frames in order.
        options: Encoder options.
        progress: Called with the number of frames done.

    Raises:
        InvalidValueError: If there are no frames, or a frame contradicts earlier frames (see `SequenceEncoder.push`).
    """
    encoder = SequenceEncoder(options)
    for number, frame in enumerate(frames):
        encoder.push(frame)
        if progress:
            progress(number + 1)
    return encoder.finish(), encoder.tracking
