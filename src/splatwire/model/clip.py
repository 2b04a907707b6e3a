"""Clips: Gaussians that move, frame by frame, in groups of frames."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from splatwire.errors import InvalidValueError
from splatwire.model.scene import Coverage, RenderHints
from splatwire.model.splat_scene import SplatScene
from splatwire.reprs import summary_repr
from splatwire.scene.background import BLACK, Background
from splatwire.scene.origin import NO_ORIGIN, Origin
from splatwire.scene.rows import Rows
from splatwire.scene.splats import Splats


@dataclass(frozen=True)
class Timeline:
    """When the frames of a clip are.

    Attributes:
        rate: Frames a second.
        num_frames: Frames of the clip.
        group_frames: Frames of a group; the last one may have fewer.
    """

    rate: Fraction
    num_frames: int
    group_frames: int

    @property
    def num_groups(self) -> int:
        """Groups of frames."""
        return -(-self.num_frames // self.group_frames)

    def frames_of(self, group: int) -> range:
        """Frames of a group."""
        first = group * self.group_frames
        return range(first, min(first + self.group_frames, self.num_frames))

    def group_of(self, frame: int) -> int:
        """The group that a frame is in.

        Raises:
            InvalidValueError: If the clip has no such frame.
        """
        if not 0 <= frame < self.num_frames:
            raise InvalidValueError(f"the clip has the frames 0 to {self.num_frames - 1}, not {frame}")
        return frame // self.group_frames


@dataclass(frozen=True, eq=False)
class GroupMotion:
    """What of a group's motion arrived.

    Attributes:
        tracks: Tracks that packets speak of and that are there in the group, ascending, int64 (n).
        moving: Which of them move, bool (n); the others stand where their bases are.
        begins: First frame of each, counted from the group's, int64 (n).
        ends: First frame after each, int64 (n).
        at: How each differs from its base in a frame, counted from the group's first, float32 (n, C):
            place in world units, rotation (vector of four times the tangent of a quarter of the angle), natural
            logarithms of scales by falling size and of opacity, red, green and blue of the harmonics' constant. Frame
            by frame, so that memory does not grow with the frames of a group.
        spoken: Tracks that packets speak of, bool (T): those of them that are not in `tracks` are gone.
        complete: Whether no packet is missing.
        unchanged: Whether the group has no motion at all: every track stays as it was.
    """

    tracks: np.ndarray
    moving: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    at: Callable[[int], np.ndarray]
    spoken: np.ndarray
    complete: bool
    unchanged: bool

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Tracks:
    """The bases of a clip: each track as it looks when it is born.

    Attributes:
        splats: The Gaussians.
        born: Group that each is born in, int64 (T).
        received: Whether each arrived, bool (T).
        blocks: Block of the stream that each base is in, int64 (T).
        rounding: Step of each one's place when it moves, world units, float32 (T); 0 where the base did not arrive.
        begins: First frame of each, counted from that of the group that it is born in, as side information tells: 0
            where it does not, int64 (T).
        ends: First frame of the clip after each, as side information tells: that after the last where it does not,
            int64 (T).
    """

    splats: Splats
    born: np.ndarray
    received: np.ndarray
    blocks: np.ndarray
    rounding: np.ndarray
    begins: np.ndarray
    ends: np.ndarray

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class ClipScene:
    """What arrived of a clip; its elements are bases and, for each group, the motion of tracks.

    Attributes:
        timeline: When the frames are.
        tracks: The bases.
        motion: What arrived of a group's motion, given which bases are there, bool (T): packets that speak of others
            wait. Decodes it anew each time, so that only what is used takes memory.
        count: Elements, N.
        background: RGB behind everything.
        antialiased: See `SplatScene`.
        origin: See `SplatScene`.
    """

    ELEMENTS: ClassVar[str] = "tracks"
    COVERAGE: ClassVar[Coverage] = SplatScene.COVERAGE
    timeline: Timeline
    tracks: Tracks
    motion: Callable[[int, np.ndarray], GroupMotion]
    count: int
    background: Background = BLACK
    antialiased: bool = False
    hints: RenderHints | None = None
    origin: Origin = NO_ORIGIN

    __repr__ = summary_repr

    @property
    def elements(self) -> Splats:
        """The bases."""
        return self.tracks.splats

    @property
    def positions(self) -> Float[np.ndarray, "T 3"]:
        """Where tracks are born."""
        return self.tracks.splats.means

    @property
    def num_elements(self) -> int:
        """Bases and motions, N."""
        return self.count

    @property
    def num_gaussians(self) -> int:
        """Tracks."""
        return self.tracks.splats.num_gaussians

    @property
    def drawable(self) -> Bool[np.ndarray, "T"]:
        """Bases that any view can draw."""
        return self.rows().kept

    def rows(self) -> Rows:
        """What becomes of the bases where they are coded."""
        return self.bases().rows()

    @property
    def facts(self) -> dict[str, int | float]:
        """Degree of the harmonics, frames, groups, frames a second."""
        time = self.timeline
        return {
            "degree": self.tracks.splats.degree,
            "frames": time.num_frames,
            "groups": time.num_groups,
            "frame_rate": float(time.rate),
        }

    def bases(self) -> SplatScene:
        """The bases as a scene of their own."""
        return SplatScene(
            self.tracks.splats, background=self.background, antialiased=self.antialiased, origin=self.origin
        )

    def select(self, index: np.ndarray) -> "ClipScene":
        """The clip itself: which of its elements are there is for its motion to say."""
        return self

    def with_elements(self, elements: Splats, hints: RenderHints | None = None) -> "ClipScene":
        """The clip with other bases."""
        return replace(self, tracks=replace(self.tracks, splats=elements), hints=hints)
