"""Where a viewer's scene comes from: a stream on disk whose transfer is played, or a server that sends it now."""

import queue
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from splatwire.codec import ProgressiveDecoder
from splatwire.conceal import conceal
from splatwire.conceal.progressive import ProgressiveConcealer
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import Manifest, Packet, SceneStream
from splatwire.scene import Anchors, Erasures
from splatwire.view.model import Settings, Status
from splatwire.view.progressive_scene import ProgressiveScene
from splatwire.view.transfer import Transfer, plan_transfer


class FileSource:
    """A stream from disk, sent through a link of chosen losses up to a chosen moment.

    It is decoded once. Settings only choose which rows are there, so the same rows as `decode_stream` would give;
    concealment follows incrementally while `progress` grows.

    Args:
        stream: The stream; packets that it lacks are lost under every setting.
        bytes_per_second: Rate of the link that is played.
        progress: Called with the share of the decoding that is done, 0 to 1.

    Raises:
        BitstreamError: If the stream contradicts itself.
        DesyncError: If the decoded integers are not those that were encoded.
    """

    live = False
    has_news = False

    def __init__(
        self,
        stream: SceneStream,
        *,
        bytes_per_second: float | int = 1_250_000,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._stream, self._rate = stream, bytes_per_second
        decoder = ProgressiveDecoder(stream.manifest, stream.side_info, progress=progress)
        decoder.add(stream.packets)
        self._full = decoder.partial
        self._complete = decoder.complete
        self._members = {packet.id: decoder.members(packet) for packet in stream.packets}
        # What the file lacks, the reference lacks: it is the best that anybody can show of this file.
        self._reference = conceal(decoder.snapshot(), "grow")
        self._partial = _emptied(self._full)
        self._concealer: ProgressiveConcealer | None = None
        self._name = ""
        self._transfer: tuple[tuple[float, float, int], Transfer] | None = None
        self._shown: tuple[int, float, int] = (0, 0.0, 0)

    @property
    def anchors(self) -> Anchors:
        """See `Source`."""
        return self._full.scene.anchors

    @property
    def sections(self) -> tuple[str, ...]:
        """See `Source`."""
        return tuple(self._full.concealment)

    @property
    def known(self) -> Bool[Tensor, "N"]:
        """See `Source`."""
        return self._partial.erasures.known

    @property
    def transfer_seconds(self) -> float:
        """Time that a transfer without loss takes."""
        return plan_transfer(self._stream, Settings(loss=0).loss_model(), seed=0, bytes_per_second=self._rate).seconds

    def reference(self) -> AnchorScene | None:
        """See `Source`."""
        return self._reference

    def scene(self, settings: Settings) -> AnchorScene:
        """See `Source`."""
        transfer = self._planned(settings)
        packets = transfer.upto(settings.progress)
        self._show(packets, settings.concealer)
        self._shown = (*transfer.moment(settings.progress), len(packets))
        assert self._concealer is not None
        return self._concealer.scene()

    def status(self) -> Status:
        """See `Source`."""
        sent, seconds, packets = self._shown
        total = self._transfer[1].num_bytes if self._transfer else None
        lacking = self._stream.manifest.num_packets - len(self._stream.packets)
        note = "" if self._complete else f"the file itself lacks {lacking} packets; PSNR is against what it has"
        known = int(self.known.sum())
        return Status(
            sent, total, seconds, packets, self._stream.manifest.num_packets, known, len(self.known), note=note
        )

    def _planned(self, settings: Settings) -> Transfer:
        key = (float(settings.loss), float(settings.burst), settings.seed)
        if self._transfer is None or self._transfer[0] != key:
            model = settings.loss_model()
            plan = plan_transfer(self._stream, model, seed=settings.seed, bytes_per_second=self._rate)
            self._transfer = (key, plan)
        return self._transfer[1]

    def _show(self, packets: tuple[Packet, ...], concealer: str) -> None:
        """Makes exactly these packets the ones that are there."""
        wanted = np.zeros(len(self.known), dtype=np.bool_)
        for packet in packets:
            wanted[self._members[packet.id]] = True
        known = self.known.numpy()
        taken_back = bool((known & ~wanted).any())
        if taken_back:
            _take_back(self._partial, np.flatnonzero(known & ~wanted))
        new = np.flatnonzero(wanted & ~known)
        _copy(self._full, self._partial, new)
        self._partial.erasures.received[torch.from_numpy(new)] = True
        if self._concealer is None or self._name != concealer:
            self._concealer, self._name = ProgressiveConcealer(self._partial, concealer), concealer
        elif taken_back:
            self._concealer.restart()
        else:
            self._concealer.arrived(new)


class LiveSource:
    """A stream that a server sends now; packets are handed over by whoever receives them, in any thread.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        progress: Called with the share of the preparation that is done, 0 to 1.

    Raises:
        BitstreamError: If the side information cannot be read.
    """

    live = True

    def __init__(
        self, manifest: Manifest, side_info: bytes, *, progress: Callable[[float], None] | None = None
    ) -> None:
        self._progressive = ProgressiveScene(manifest, side_info, "drop", progress=progress)
        self._concealer = "drop"
        # A receiver hands each packet over once, so this is bounded by the stream that its limits allowed.
        self._waiting: queue.SimpleQueue[Packet] = queue.SimpleQueue()
        self._head_bytes = len(side_info)
        self._bytes = len(side_info)
        self.seconds = 0.0
        self.note = "receiving"

    @property
    def anchors(self) -> Anchors:
        """See `Source`."""
        return self._progressive.decoder.partial.scene.anchors

    @property
    def sections(self) -> tuple[str, ...]:
        """See `Source`."""
        return tuple(self._progressive.decoder.partial.concealment)

    @property
    def known(self) -> Bool[Tensor, "N"]:
        """See `Source`."""
        return self._progressive.decoder.partial.erasures.known

    @property
    def has_news(self) -> bool:
        """Whether packets wait to be shown."""
        return not self._waiting.empty()

    def hand_over(self, packet: Packet) -> None:
        """Takes a packet; costs next to nothing."""
        self._waiting.put(packet)

    def reference(self) -> AnchorScene | None:
        """See `Source`; known once everything has arrived, and then it is the scene itself."""
        return None

    def scene(self, settings: Settings) -> AnchorScene:
        """See `Source`; losses and progress are what they are."""
        packets = []
        while not self._waiting.empty():
            packets.append(self._waiting.get())
        self._progressive.add(packets)
        self._bytes += sum(packet.num_bytes for packet in packets)
        if settings.concealer != self._concealer:
            self._progressive.conceal_with(settings.concealer)
            self._concealer = settings.concealer
        with self._progressive.reading() as scene:
            return scene  # only this thread adds packets, so nobody changes it before the next call

    def status(self) -> Status:
        """See `Source`."""
        scene = self._progressive
        report = scene.decoder.report
        return Status(
            self._bytes, None, self.seconds, report.num_received, report.num_expected,
            scene.num_known, scene.num_anchors, note=self.note,
        )  # fmt: skip


_ATTRIBUTES = ("features", "scalings", "offsets", "mask")


def _emptied(partial: PartialScene) -> PartialScene:
    """The same scene with nothing received."""
    anchors = partial.scene.anchors
    nothing = {name: torch.zeros_like(getattr(anchors, name)) for name in _ATTRIBUTES}
    scene = replace(partial.scene, anchors=Anchors(positions=anchors.positions, **nothing))
    return replace(partial, scene=scene, erasures=Erasures(torch.zeros_like(partial.erasures.received)))


def _copy(source: PartialScene, target: PartialScene, rows: np.ndarray) -> None:
    index = torch.from_numpy(rows)
    for name in _ATTRIBUTES:
        getattr(target.scene.anchors, name)[index] = getattr(source.scene.anchors, name)[index]


def _take_back(partial: PartialScene, rows: np.ndarray) -> None:
    index = torch.from_numpy(rows)
    for name in _ATTRIBUTES:
        getattr(partial.scene.anchors, name)[index] = 0
    partial.erasures.received[index] = False
