"""Sequences of moving Gaussians, divided into groups of pictures (GOPs)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.reprs import summary_repr
from splatwire.types.background import BLACK, Background
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.scene import GrowStrength, RenderHints
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from splatwire.types.validity import ElementValidity


@dataclass(frozen=True)
class Timeline:
    """Frame rate of a sequence, its length, and its division into groups of pictures (GOPs).

    Attributes:
        rate: Frames per second.
        num_frames: Number of frames of the sequence.
        group_frames: Number of frames per group; the last group may have fewer.
    """

    rate: Fraction
    num_frames: int
    group_frames: int

    @property
    def num_groups(self) -> int:
        """Number of groups of pictures."""
        return -(-self.num_frames // self.group_frames)

    def frames_of(self, group: int) -> range:
        """Returns the frame indices of a group of pictures."""
        first = group * self.group_frames
        return range(first, min(first + self.group_frames, self.num_frames))

    def group_of(self, frame: int) -> int:
        """Returns the group that contains a frame.

        Raises:
            InvalidValueError: If the sequence has no such frame.
        """
        if not 0 <= frame < self.num_frames:
            raise InvalidValueError(f"the clip has the frames 0 to {self.num_frames - 1}, not {frame}")
        return frame // self.group_frames


@dataclass(frozen=True, eq=False)
class GroupMotion:
    """Received motion of one group of pictures (GOP): tracks and their changes in each frame.

    A track is one Gaussian over time. Its changes are relative to the keyframe Gaussian, which is its first state.

    Attributes:
        tracks: Indices of the received tracks that exist in the group, ascending, int64 (n).
        moving: Mask of the tracks that move, bool (n).
        begins: Index of each track's first frame in the group, counted from the start of the group, int64 (n).
        ends: Index of the frame after each track's last frame in the group, counted from the start of the group, int64
            (n).
        at: Function that decodes the changes of the tracks in a frame of the group, float32 (n, C). The C channels are,
            in this order: position (3, world units), rotation vector (3, of length `4 * tan(angle / 4)`), natural
            logarithms of the scales (3, largest scale first), natural logarithm of the opacity (1), and coefficients of
            the spherical harmonics of degree 0 (3).
        covered: Mask of tracks for which a packet of the group was received, bool (T).
        complete: True if no packet is missing.
        unchanged: True if the group has no motion.
    """

    tracks: np.ndarray
    moving: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    at: Callable[[int], np.ndarray]
    covered: np.ndarray
    complete: bool
    unchanged: bool

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Tracks:
    """First state and lifetime of each track of a sequence; a track is one Gaussian over time.

    Attributes:
        splats: State of each track in its first frame (its keyframe Gaussian).
        born: Index of the group of pictures in which each track begins, int64 (T).
        received: Mask of tracks whose keyframe Gaussian was received, bool (T).
        blocks: Index of the block that contains each keyframe Gaussian, int64 (T). A block is a part of the stream with
            Gaussians that are coded together.
        rounding: Quantisation step of the positions of each track, world units, float32 (T); 0 for lost tracks.
        begins: Index of the first frame of each track, counted from the start of group `born`, int64 (T); 0 if unknown.
        ends: Index of the frame after the last frame of each track, counted from the start of the sequence, int64 (T);
            the number of frames of the sequence if unknown.
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
class SequenceScene:
    """A received sequence of moving Gaussians.

    Attributes:
        timeline: Frame rate, number of frames, and groups of pictures.
        tracks: The keyframe Gaussians.
        motion: Function that decodes the received motion of a group. Its arguments are the index of the group and the
            mask of received keyframe Gaussians, bool (T).
        count: Number of coded elements, N: the keyframe Gaussians (one per track), plus for each group the tracks whose
            motion is coded.
        background: RGB of the background.
        antialiased: True if the scene was trained with antialiased rendering (Mip-Splatting). Renderers then lower the
            opacity of Gaussians that they widen to a pixel.
        origin: World coordinates of the point that positions are relative to.
        metadata: Title, author, license, and the initial view.
    """

    ELEMENTS: ClassVar[str] = "tracks"
    GROW_STRENGTH: ClassVar[GrowStrength] = SplatScene.GROW_STRENGTH
    timeline: Timeline
    tracks: Tracks
    motion: Callable[[int, np.ndarray], GroupMotion]
    count: int
    background: Background = BLACK
    antialiased: bool = False
    hints: RenderHints | None = None
    origin: Origin = NO_ORIGIN
    metadata: SceneMetadata = NO_METADATA

    __repr__ = summary_repr

    @property
    def elements(self) -> Splats:
        """Keyframe Gaussians of the sequence, one per track."""
        return self.tracks.splats

    @property
    def positions(self) -> Float[np.ndarray, "T 3"]:
        """Position of each track in its first frame."""
        return self.tracks.splats.means

    @property
    def num_elements(self) -> int:
        """Number of coded elements: the keyframe Gaussians, plus for each group the tracks whose motion is coded."""
        return self.count

    @property
    def num_gaussians(self) -> int:
        """Number of tracks. A track is one Gaussian over time."""
        return self.tracks.splats.num_gaussians

    @property
    def drawable(self) -> Bool[np.ndarray, "T"]:
        """Mask of the keyframe Gaussians that can be drawn: visible, and without invalid values."""
        return self.validity().kept

    def validity(self) -> ElementValidity:
        """Classifies the keyframe Gaussians as drawable, invisible or invalid."""
        return self.keyframes().validity()

    @property
    def facts(self) -> dict[str, int | float]:
        """Statistics for display: degree of the harmonics, numbers of frames and groups, frames per second."""
        time = self.timeline
        return {
            "degree": self.tracks.splats.degree,
            "frames": time.num_frames,
            "groups": time.num_groups,
            "frame_rate": float(time.rate),
        }

    def keyframes(self) -> SplatScene:
        """Returns the keyframe Gaussians of all tracks as a static scene."""
        return SplatScene(
            self.tracks.splats,
            background=self.background,
            antialiased=self.antialiased,
            origin=self.origin,
            metadata=self.metadata,
        )

    def select(self, index: np.ndarray) -> "SequenceScene":
        """Returns the complete sequence and ignores `index`, because tracks of a sequence cannot be selected."""
        # Motion refers to tracks by index.
        return self

    @checked
    def with_elements(self, elements: Splats, hints: RenderHints | None = None) -> "SequenceScene":
        """Returns the sequence with its keyframe Gaussians replaced.

        Args:
            elements: The new keyframe Gaussians.
            hints: Factors on size and opacity, and hidden Gaussians, set by loss concealment; None for no changes.
        """
        return replace(self, tracks=replace(self.tracks, splats=elements), hints=hints)
