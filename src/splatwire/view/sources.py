"""Where a viewer's scene comes from: a stream on disk whose transfer is played, or a server that sends it now."""

import queue
from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor

from splatwire.codec.preview import preview_scene
from splatwire.conceal import conceal
from splatwire.errors import BitstreamError
from splatwire.model import SplatScene
from splatwire.model.appearance import Scene
from splatwire.packets import Packet, SceneStream
from splatwire.transport import Event, Finished, PacketArrived, SideInfoArrived, Welcomed
from splatwire.view.model import Settings, Status
from splatwire.view.progressive_scene import ProgressiveScene
from splatwire.view.transfer import Playback, plan_transfer

_WORDS = {"complete": "everything has arrived", "sent": "everything was sent, some was lost"}


class FileSource:
    """A stream from disk, sent through a link of chosen losses up to a chosen moment.

    It is decoded once. Settings only choose which rows are there, so the same rows as `decode_stream` would give;
    concealment follows incrementally while `progress` grows.

    Args:
        stream: The stream; packets that it lacks are lost under every setting.
        progress: Called with the share of the decoding that is done, 0 to 1.

    Raises:
        BitstreamError: If the stream contradicts itself.
        DesyncError: If the decoded integers are not those that were encoded.
    """

    pending = False
    preview = None

    def __init__(
        self,
        stream: SceneStream,
        *,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._stream = stream
        self._concealer = "drop"
        self.progressive = ProgressiveScene(stream.manifest, stream.side_info, self._concealer, progress=progress)
        self.progressive.add(stream.packets)
        # What the file lacks, the reference lacks: it is the best that anybody can show of this file.
        self._reference = conceal(self.progressive.decoder.snapshot(), "grow")
        self._playback: tuple[tuple[float, float, int], Playback] | None = None
        self._shown: tuple[int, float, int] = (0, 0.0, 0)

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """See `Source`."""
        return self.progressive.positions

    def advance(self) -> bool:
        """See `Source`."""
        return False

    def reference(self) -> Scene | None:
        """See `Source`."""
        return self._reference

    def scene(self, settings: Settings) -> Scene:
        """See `Source`."""
        playback = self._planned(settings)
        packets = playback.upto(settings.progress)
        if settings.concealer != self._concealer:
            self.progressive.conceal_with(settings.concealer)
            self._concealer = settings.concealer
        self.progressive.show(packets)
        self._shown = (*playback.moment(settings.progress), len(packets))
        with self.progressive.reading() as scene:
            return scene  # only this thread shows packets, so nobody changes it before the next call

    def status(self) -> Status:
        """See `Source`."""
        sent, seconds, packets = self._shown
        total = self._playback[1].num_bytes if self._playback else None
        expected, scene = self._stream.manifest.num_packets, self.progressive
        lacking = expected - len(self._stream.packets)
        note = f"the file itself lacks {lacking} packets; PSNR is against what it has" if lacking else ""
        return Status(sent, total, seconds, packets, expected, scene.num_known, len(scene.known), note=note)

    def _planned(self, settings: Settings) -> Playback:
        key = (float(settings.loss), float(settings.burst), settings.seed)
        if self._playback is None or self._playback[0] != key:
            self._playback = (key, plan_transfer(self._stream, settings.loss_model(), seed=settings.seed))
        return self._playback[1]


class LiveSource:
    """What a server sends now: its preview, and the scene as soon as its side information is there.

    Whoever receives hands over what arrives, in any thread; one other thread draws.
    """

    def __init__(self) -> None:
        self.preview: SplatScene | None = None
        self.progressive: ProgressiveScene | None = None
        self._concealer = "drop"
        self._welcomed: Welcomed | None = None
        self._arrived: SideInfoArrived | None = None
        # A receiver hands each packet over once, so this is bounded by the stream that its limits allowed.
        self._waiting: queue.SimpleQueue[Packet] = queue.SimpleQueue()
        self._bytes = 0
        self._damaged = ""
        self.has_scene = self._over = False
        self.seconds = 0.0
        self.note = "receiving"

    @property
    def pending(self) -> bool:
        """See `Source`."""
        return not self._over or self._arrived is not None or not self._waiting.empty()

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """See `Source`; there is a preview or a scene."""
        if self.progressive is not None:
            return self.progressive.positions
        assert self.preview is not None
        return self.preview.positions

    def take(self, event: Event, seconds: float) -> None:
        """Takes what happened; costs next to nothing.

        Args:
            event: What a receiver tells.
            seconds: When, since the beginning.
        """
        self.seconds = seconds
        match event:
            case PacketArrived():
                self._waiting.put(event.packet)
            case Welcomed(preview=preview) if preview:
                self._welcomed = event
                self._take_preview(preview)
            case SideInfoArrived():
                self._arrived, self.has_scene, self.note = event, True, f"receiving{self._damaged}"
            case Finished():
                self.end(_WORDS.get(event.reason, event.reason))

    def end(self, reason: str) -> None:
        """Says that nothing more will come, and why."""
        self._over = True
        self.note = reason if self.has_scene else f"no scene arrived ({reason}): this is its preview"

    def _take_preview(self, preview: bytes) -> None:
        """Takes a preview, if it is one: the scene may be good all the same."""
        try:
            self.preview, self.note = preview_scene(preview), "a preview, until the scene is there"
        except BitstreamError as error:
            self._damaged = f"; what should have been its {error}"

    def advance(self, progress: Callable[[float], None] | None = None) -> bool:
        """See `Source`: goes over to the scene when it is time.

        Args:
            progress: Called with the share of its preparation that is done, 0 to 1.

        Raises:
            BitstreamError: If its side information cannot be read; the preview stays.
        """
        if self.progressive is not None:
            return not self._waiting.empty()
        if self._arrived is None:
            return False
        arrived, self._arrived = self._arrived, None  # once: what cannot be read will not be read the next time
        self.progressive = ProgressiveScene(
            arrived.manifest, arrived.side_info, self._concealer, intake=arrived.intake, progress=progress
        )
        self._bytes, self.preview = len(arrived.side_info), None
        return True

    def reference(self) -> Scene | None:
        """See `Source`; there is none: once everything has arrived, it is the scene itself."""
        return None

    def scene(self, settings: Settings) -> Scene:
        """See `Source`; losses and progress are what they are."""
        assert self.progressive is not None
        packets = []
        while not self._waiting.empty():
            packets.append(self._waiting.get())
        self.progressive.add(packets)
        self._bytes += sum(packet.num_bytes for packet in packets)
        if settings.concealer != self._concealer:
            self.progressive.conceal_with(settings.concealer)
            self._concealer = settings.concealer
        with self.progressive.reading() as scene:
            return scene  # only this thread adds packets, so nobody changes it before the next call

    def status(self) -> Status:
        """See `Source`."""
        scene, welcomed = self.progressive, self._welcomed
        if scene is not None:
            decoder, known = scene.decoder, scene.known
            packets, expected = decoder.num_packets, decoder.manifest.num_packets
            return Status(
                self._bytes, None, self.seconds, packets, expected, scene.num_known, len(known), note=self.note
            )
        sent, expected = (len(welcomed.preview), welcomed.num_packets) if welcomed else (0, 0)
        return Status(sent, None, self.seconds, 0, expected, 0, 0, note=self.note)
