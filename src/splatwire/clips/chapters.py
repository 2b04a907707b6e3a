"""A clip without end: chapters, each a clip of its own, so that what is held does not grow."""

from collections.abc import Callable

from splatwire.clips.encoding import ClipEncoder
from splatwire.clips.frames import Frame
from splatwire.clips.options import ClipOptions
from splatwire.packets import Packet
from splatwire.scene.splats import Splats
from splatwire.transport.broadcast import PROTECTION, Broadcast, Edition
from splatwire.transport.protection import Protection

CHAPTER_GROUPS = 120
"""Groups of frames of a chapter: a minute of groups of 15 at 30 frames a second. Bases are sent anew in each."""
CHAPTER_BYTES = 1 << 26
"""A chapter with more bytes ends sooner: server and receivers hold one."""


class EndlessClip:
    """Frames in, what is served out: after each group an edition, of another stream where a chapter begins.

    Args:
        options: How frames are encoded.
        new_id: Gives ids of streams.
        protection: Where redundancy goes.
        chapter_groups: Groups of frames of a chapter.
    """

    def __init__(
        self, options: ClipOptions, new_id: Callable[[], int], protection: Protection = PROTECTION,
        chapter_groups: int = CHAPTER_GROUPS,
    ) -> None:  # fmt: skip
        self._options, self._new_id, self._protection = options, new_id, protection
        self._chapter_groups = chapter_groups
        self._begin(ClipEncoder(options, live=True))
        self.num_frames = self._num_served = 0

    def push(self, frame: Frame | Splats) -> Edition | None:
        """Takes the next frame; what is served from now on if it is the last of a group.

        Raises:
            InvalidValueError: See `ClipEncoder.push`.
        """
        taken = frame if isinstance(frame, Frame) else Frame.of(frame)
        begins = not self.num_frames % self._options.group_frames
        if begins and self._full and taken.drawn.any():  # a clip begins with something that draws
            self._begin(self.encoder.next_chapter())
        packets = self.encoder.push(taken)
        self.num_frames += 1
        if self.num_frames % self._options.group_frames:
            return None
        edition = self._add(packets)
        self._num_served = self.num_frames
        return edition

    def restart(self) -> None:
        """Drops the group that frames are being gathered for, and begins a chapter that shares nothing with before.

        For frames of another kind (degree of harmonics), and after a group that could not be encoded.
        """
        self.num_frames = self._num_served
        self._begin(self.encoder.restarted(self.num_frames))

    def end(self) -> list[Edition]:
        """What is served at the end, one after the other: the frames since the last group, and that nothing follows."""
        if not self.num_frames:
            return []
        rest = [self._add(self.encoder.flush())] if self.num_frames % self._options.group_frames else []
        return [*rest, self._broadcast.end(*self.encoder.so_far(self._stream_id))]

    @property
    def _full(self) -> bool:
        return self._groups >= self._chapter_groups or self._num_bytes > CHAPTER_BYTES

    def _begin(self, encoder: ClipEncoder) -> None:
        self.encoder, self._stream_id = encoder, self._new_id()
        self._broadcast = Broadcast(self._protection, encoder.worth)
        self._groups = self._num_bytes = 0

    def _add(self, packets: list[Packet]) -> Edition:
        self._groups += 1
        self._num_bytes += sum(packet.num_bytes for packet in packets)
        return self._broadcast.add(*self.encoder.so_far(self._stream_id), packets)
