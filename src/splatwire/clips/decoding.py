"""Clips to frames, group by group: what is held is one group, and where each track was when the one before ended."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from splatwire.clips.concealers import DEFAULT, ClipConcealer, clip_concealer
from splatwire.clips.concealment import conceal_group
from splatwire.clips.poses import GroupPoses, Memory
from splatwire.codec import ProgressiveDecoder
from splatwire.codec.memory import check_memory
from splatwire.conceal import conceal
from splatwire.errors import BitstreamError
from splatwire.model import Partial, RenderHints, SplatScene
from splatwire.model.clip import ClipScene
from splatwire.ops.threads import share
from splatwire.packets import Manifest, Packet
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

AT_ONCE = 1 << 13
"""Gaussians that a thread moves at a time."""


@dataclass(frozen=True, eq=False)
class ClipFrame:
    """A frame of a clip, decoded and concealed.

    Attributes:
        number: Which.
        scene: The Gaussians that are drawn.
        tracks: Track of each, int64 (M).
        concealed: Whose motion was lost, bool (M).
    """

    number: int
    scene: SplatScene
    tracks: np.ndarray
    concealed: np.ndarray


def decode_frames(
    clip: ClipScene,
    concealer: ClipConcealer | str = DEFAULT,
    *,
    first: int = 0,
    there: Callable[[int], np.ndarray] | None = None,
) -> Iterator[ClipFrame]:
    """Frames of a clip, one after another.

    Args:
        clip: What arrived of it.
        concealer: What becomes of tracks whose motion was lost, or its name.
        first: The first frame that is wanted: nothing of groups before its own is decoded.
        there: Which bases are there when a group begins, bool (T), by group; None for all that arrived.

    Raises:
        InvalidValueError: If the clip has no such frame.
        UnknownNameError: If there is no such concealer.
    """
    method = clip_concealer(concealer) if isinstance(concealer, str) else concealer
    begin = clip.timeline.group_of(first)
    memory: Memory | None = None
    for group in range(begin, clip.timeline.num_groups):
        known = clip.tracks.received if there is None else clip.tracks.received & there(group)
        frames, after = decode_group(clip, group, known, memory, method)
        yield from (frame for frame in frames if frame.number >= first)
        memory = after()


def decode_group(
    clip: ClipScene, group: int, known: np.ndarray, memory: Memory | None, method: ClipConcealer
) -> tuple[Iterator[ClipFrame], Callable[[], Memory]]:
    """The frames of a group, each made when it is asked for, and what tells the next group what it wants to know of it.

    Args:
        clip: What arrived of the clip.
        group: The group.
        known: Bases that are there, bool (T).
        memory: Of the group before; None for none.
        method: What becomes of tracks whose motion was lost.
    """
    poses, after = conceal_group(clip, clip.motion(group, known), group, known, memory, method)
    hints = grown(clip, known, group) if method.grow else None
    numbers = enumerate(clip.timeline.frames_of(group))
    return (posed(clip, poses, index, number, hints) for index, number in numbers), after


def decode_frame(clip: ClipScene, number: int, concealer: ClipConcealer | str = DEFAULT) -> ClipFrame:
    """One frame; decodes its group alone, so that losses are concealed from that group alone."""
    return next(decode_frames(clip, concealer, first=number))


class ClipDecoder:
    """Decodes a clip while it arrives, packet by packet, in any order.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        concealer: What becomes of tracks whose motion was lost, or its name.

    Raises:
        BitstreamError: If the side information contradicts the manifest, or the stream is no clip.
        UnknownNameError: If there is no such concealer.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, concealer: ClipConcealer | str = DEFAULT) -> None:
        if not manifest.schema.timed:
            raise BitstreamError(f"a stream of {manifest.elements} is a scene, not a clip")
        self._concealer = clip_concealer(concealer) if isinstance(concealer, str) else concealer
        self._decoder = ProgressiveDecoder(manifest, side_info)

    @property
    def complete(self) -> bool:
        """Whether every packet has arrived."""
        return self._decoder.complete

    def push(self, packet: Packet) -> None:
        """Takes a packet; what the clip has no place for, or is there already, is passed over.

        Raises:
            DesyncError: If now everything is there and yet the decoded integers are not those that were encoded.
        """
        self._decoder.add([packet])

    def frame(self, number: int) -> ClipFrame:
        """A frame as it can be shown now.

        Raises:
            InvalidValueError: If the clip has no such frame.
            BitstreamError: If tracks are announced that take more memory than what arrived may
                (`splatwire.codec.memory`): of more than 150,000 some have to be there first.
        """
        check_memory(self._decoder.scene_bytes, self._decoder.num_bytes, "a frame of all tracks that are announced")
        return decode_frame(self._decoder.partial.scene, number, self._concealer)


def posed(clip: ClipScene, poses: GroupPoses, index: int, number: int, hints: RenderHints | None) -> ClipFrame:
    """The frame that poses of a group show.

    Args:
        clip: The clip.
        poses: Of the group.
        index: Frame within the group.
        number: Frame of the clip.
        hints: How to draw bases while others are missing, by track.
    """
    here = np.flatnonzero((poses.begins <= index) & (index < poses.ends))
    tracks = poses.tracks[here]
    offsets = poses.at(index)
    splats = moved(clip.tracks.splats, tracks, offsets if len(here) == len(offsets) else offsets[here])
    scene = SplatScene(splats, background=clip.background, antialiased=clip.antialiased, origin=clip.origin)
    if hints is not None:
        opacity = None if hints.opacity_gain is None else hints.opacity_gain[tracks]
        own = RenderHints(hints.size_gain[tracks], np.zeros(len(tracks), np.bool_), opacity)
        scene = replace(scene, splats=SplatScene(splats, own).drawn())
    return ClipFrame(number, scene, tracks, poses.concealed[here])


def moved(splats: Splats, tracks: np.ndarray, offsets: np.ndarray) -> Splats:
    """Some of the Gaussians, moved.

    Args:
        splats: All of them.
        tracks: Which, int64 (n).
        offsets: How each differs then, float32 (n, C) as in `splatwire.model.clip.GroupMotion.at`.
    """
    from splatwire.clips import _pose_kernels as kernels

    found = Splats.empty(len(tracks), splats.degree)
    bases, offsets, whole = _arrays(splats), np.ascontiguousarray(offsets), _arrays(found)

    def move(some: slice) -> None:
        kernels.move(bases, tracks[some], offsets[some], tuple(values[some] for values in whole))

    share(move, [slice(begin, begin + AT_ONCE) for begin in range(0, len(tracks), AT_ONCE)])
    return found


def _arrays(splats: Splats) -> tuple[np.ndarray, ...]:
    """The attributes as the kernel takes them, in the memory of the Gaussians if that is contiguous."""
    means, quats, scales, opacities, sh = (np.ascontiguousarray(values) for values in vars(splats).values())
    return means, quats, scales, opacities, sh.reshape(len(sh), 3 * sh.shape[1])


def grown(clip: ClipScene, there: np.ndarray, group: int) -> RenderHints | None:
    """How bases that are there make up for those that are not; None where none is missing."""
    born = clip.tracks.born <= group
    if bool(there[born].all()):
        return None
    index = np.flatnonzero(born)
    known = there[index]
    splats = clip.tracks.splats.select(index)
    scene = conceal(Partial(SplatScene(splats), Erasures.of_anchors(known)), "grow")
    hints: RenderHints | None = scene.hints
    if hints is None:
        return None
    size, opacity = np.ones(clip.num_gaussians, np.float32), np.ones(clip.num_gaussians, np.float32)
    size[index] = hints.size_gain
    if hints.opacity_gain is not None:
        opacity[index] = hints.opacity_gain
    return RenderHints(size, np.zeros(clip.num_gaussians, np.bool_), opacity)
