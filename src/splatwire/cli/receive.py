"""`splatwire receive`: a stream comes over the network."""

import asyncio
import contextlib
import itertools
import re
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import STANDARD, STREAM_SUFFIX, output_path, prepared_output, read_report_json
from splatwire.cli._live_frames import LiveFrames
from splatwire.cli._output import (
    DAMAGED,
    JsonFlag,
    Reporter,
    print_json,
    print_summary,
    progress_bars,
    tell_lost_harmonics,
)
from splatwire.cli._receiving import TrustOptions

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.packets.view import Look
    from splatwire.transport import Event, Receiver, ReceiverOptions
    from splatwire.transport.address import Address

EXPLICIT_SUFFIXES = (".ply", ".spz", ".sog", ".splat")
"""Ends of the names of files of explicit Gaussians."""


@dataclass(frozen=True)
class Receive:
    """Receive a stream over UDP or QUIC; what arrived by the deadline is enough for a scene or its preview."""

    url: tyro.conf.Positional[str]
    """udp://HOST[:PORT][/NAME], quic://HOST[:PORT][/NAME] or moq://RELAY[:PORT]/NAME."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if it ends in .swz (or is -), a folder of packets otherwise; of a clip that is sent
    live, a folder with a PLY for each frame as soon as it can be shown, and with .swz a file for each of its chapters,
    the last one under this name, those before as NAME.000.swz and so on. With --conceal a scene; a
    name that ends in .ply, .spz, .sog or .splat gets the explicit Gaussians. If only the preview arrived, that is
    written beside it, as NAME.preview.ply."""
    deadline: str | None = None
    """Take what is there after this time, e.g. 2s or 500ms; without it, wait for everything. Ctrl-C takes what is
    there, too."""
    partial: bool = False
    """Exit with status 0 if packets are missing; without it the status is 3, unless --deadline has passed. What arrived
    is written either way. A server that falls silent is greeted again for a minute, and the transfer resumed."""
    no_nack: bool = False
    """Do not ask for lost packets again."""
    camera: Path | None = None
    """Cameras file: of a stream with levels, what its first camera sees comes first, and then nothing else."""
    conceal: str | None = None
    """Decode, hide what was lost with this concealer (drop, prior, idw, cari, grow, ...), and write a scene file; of a
    clip (drop, hold, motion, ...) a folder with a PLY for each frame."""
    trust: TrustOptions = field(default_factory=TrustOptions)
    pcap: Path | None = None
    """Write all datagrams, sent and received, to this file in the format of tcpdump."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.cli._clips import check_concealer
        from splatwire.errors import MissingSideInfoError
        from splatwire.packets import write_stream
        from splatwire.transport import ReceiverOptions, StreamLeft
        from splatwire.transport.address import parse_url

        address = parse_url(self.url)
        deadline = None if self.deadline is None else parse_seconds(self.deadline)
        look = None if self.camera is None else self._look(self.camera)
        options = ReceiverOptions(name=address.name, deadline_s=deadline, nack=not self.no_nack, look=look)
        if self.conceal is not None:
            check_concealer(self.conceal)
        moments, chapters = Moments(), itertools.count()
        with progress_bars() as show, self._output() as path, LiveFrames(path, self.conceal, show) as live:

            def note(event: "Event") -> None:
                moments.note(event, show)
                live.note(event)
                if isinstance(event, StreamLeft) and not live.began:
                    self._keep_chapter(event.stream, next(chapters))

            receiver, stopped = self._transfer(address, options, note)
            stream, over = receiver.stream(), receiver.finished
            reason = over.reason if over else "stopped"
            if stream is None:
                instead = self._keep_preview(receiver.preview)
                lacking = receiver.lacking()
                why = f"{reason}: {lacking}" if lacking else reason
                raise MissingSideInfoError(f"{self.url}: no scene arrived ({why}){instead}")
            if live.began:
                live.finish()
            elif self.conceal is None and not self._explicit:
                write_stream(stream, path)
            else:
                self._write_scene(stream, path, show)
        self._tell(receiver, stream, reason, moments)
        if stopped:
            raise KeyboardInterrupt  # for the exit status; what arrived is written
        if not (self.partial or _is_all(receiver, reason)):
            print(
                f"splatwire: error: {self.url}: the stream is incomplete ({reason}: {receiver.lacking()}); what "
                f"arrived is in {self.output}. Receive it again, or accept this with --partial", file=sys.stderr,
            )  # fmt: skip
            sys.exit(DAMAGED)

    def _look(self, camera: Path) -> "Look":
        """Where the first camera of a file looks from."""
        from splatwire.data import load_cameras
        from splatwire.levels.walk import look_of

        return look_of(load_cameras(camera))

    def _transfer(
        self, address: "Address", options: "ReceiverOptions", note: Callable[["Event"], None]
    ) -> "tuple[Receiver, bool]":
        """Runs the transfer, with the capture that was asked for; says whether somebody ended it."""
        from splatwire.transport.pcap import Capture

        transfer = self.trust.transfer(address)
        with contextlib.ExitStack() as stack:
            tap = None
            if self.pcap is not None:
                capture = Capture(stack.enter_context(self.pcap.open("wb")).write)
                tap = lambda source, target, data: capture.add(source, target, data, time.time())  # noqa: E731
            return asyncio.run(_stoppable(lambda stop: transfer(options, note, tap=tap, stop=stop)))

    def _keep_chapter(self, stream: "SceneStream", number: int) -> None:
        """Writes a chapter of an endless clip that has ended beside the output, which the last one gets."""
        from splatwire.packets import write_stream

        path = prepared_output(Path(self.output).resolve().with_suffix(f".{number:03}{STREAM_SUFFIX}"))
        write_stream(stream, path)

    def _keep_preview(self, preview: bytes) -> str:
        """Writes the preview beside the output that there is not, as a PLY of 3DGS; says what became of it."""
        if not preview:
            return ""
        from splatwire.codec.preview import preview_scene
        from splatwire.errors import BitstreamError
        from splatwire.formats.ply import write_ply

        try:
            shown = preview_scene(preview)
        except BitstreamError as error:
            return f", and what should have been its {error}"
        if self.output == STANDARD:
            return "; its preview did, but standard output is for the scene: name a file with -o to keep it"
        path = prepared_output(Path(self.output).resolve().with_suffix(".preview.ply"))
        write_ply([shown.splats], path)
        behind = " ".join(f"{value:.3f}" for value in shown.background)
        return f"; its preview did: {shown.num_elements} Gaussians before {behind} (RGB) -> {path}"

    @property
    def _explicit(self) -> bool:
        """Whether the output's name is that of a file of explicit Gaussians."""
        return Path(self.output).suffix.lower() in EXPLICIT_SUFFIXES

    def _output(self) -> contextlib.AbstractContextManager[Path]:
        suffix = Path(self.output).suffix if self._explicit else STREAM_SUFFIX if self.conceal is None else ""
        return output_path(self.output, suffix=suffix, json=self.json)

    def _write_scene(self, stream: "SceneStream", path: Path, show: "Reporter") -> None:
        from splatwire.cli._clips import check_num_frames, write_frames
        from splatwire.codec import decode_stream
        from splatwire.conceal import create_concealer
        from splatwire.errors import InvalidValueError
        from splatwire.packets import write_stream
        from splatwire.scene_io import save_decoded

        if stream.manifest.schema.timed and not self._explicit:
            check_num_frames(stream, None, f"receive it to a {STREAM_SUFFIX} file, and decode that with --max-frames")
            path.mkdir(exist_ok=True)
            write_frames(stream, path, ".ply", self.conceal or "", None, show)
            return
        if self._explicit != stream.manifest.schema.explicit or stream.manifest.schema.timed:
            kept = Path(self.output).resolve().with_suffix(STREAM_SUFFIX)
            write_stream(stream, prepared_output(kept))
            raise InvalidValueError(
                f"{self.url} sent {stream.manifest.elements}, which {self.output} is no name for; what arrived is in "
                f"{kept}: `splatwire decode` or `splatwire export` take it from there"
            )
        concealer = None if self.conceal is None else create_concealer(self.conceal)
        tell_lost_harmonics(save_decoded(decode_stream(stream), concealer, path), self.output)

    def _tell(self, receiver: "Receiver", stream: "SceneStream", reason: str, moments: "Moments") -> None:
        report, collector = receiver.report(), receiver.collector
        assert report is not None
        assert collector is not None
        if self.json:
            print_json(
                {
                    "output": self.output,
                    "finished": reason,
                    "seconds": moments.seconds(),
                    "seconds_to_preview": moments.preview,
                    "seconds_to_side_info": moments.side_info,
                    "bytes_received": receiver.num_bytes,
                    "datagrams_received": receiver.num_datagrams,
                    "datagrams_rejected": receiver.num_rejected + collector.num_bad,
                    "packets_repaired": collector.num_repaired,
                    "stream_id": f"{stream.manifest.stream_id:08x}",
                    "packets": read_report_json(report),
                }
            )
        else:
            text = f"{report.num_received} of {report.num_expected} packets in {moments.seconds():.2f} s ({reason})"
            print_summary(f"{text} -> {self.output}", self.output)


def _is_all(receiver: "Receiver", reason: str) -> bool:
    """Whether all has arrived that can be had: everything, what a camera sees, or what was there by a deadline.

    Of a live clip, motion from before the client came is never sent: it is all there when the server has ended it.
    """
    return reason in ("complete", "seen", "deadline") or (reason == "sent" and receiver.is_live)


class Moments:
    """When what happened, in seconds from the beginning."""

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self._packets = 0
        self._expected = 1
        self.preview: float | None = None
        self.side_info: float | None = None
        self.end: float | None = None

    def seconds(self) -> float:
        """From the beginning to the end of the transfer."""
        return time.perf_counter() - self._began if self.end is None else self.end

    def note(self, event: "Event", show: Reporter) -> None:
        """Takes an event of the receiver."""
        from splatwire.transport import Finished, PacketArrived, SideInfoArrived, Welcomed
        from splatwire.transport.events import Interrupted, Resumed

        match event:
            case Welcomed():
                self._expected = max(event.num_packets, 1)
                if event.preview and self.preview is None:
                    self.preview = time.perf_counter() - self._began
            case Interrupted():
                print("splatwire: warning: the server fell silent; greeting it again", file=sys.stderr, flush=True)
            case Resumed():
                how = "going on" if event.kept else "it sends another stream, which begins anew"
                print(f"splatwire: warning: the server answers again: {how}", file=sys.stderr, flush=True)
                self._packets = self._packets if event.kept else 0
            case SideInfoArrived():
                self.side_info = self.side_info or time.perf_counter() - self._began
            case PacketArrived():
                self._packets += 1
                if self._packets % 64 == 0:
                    show("receiving", self._packets / self._expected)
            case Finished():
                self.end = time.perf_counter() - self._began


async def _stoppable(
    transfer: "Callable[[asyncio.Future[None]], Awaitable[Receiver]]",
) -> "tuple[Receiver, bool]":
    """Runs a transfer that Ctrl-C or a request to end ends where it is; says whether one did."""
    loop = asyncio.get_running_loop()
    stop = loop.create_future()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.cancel)
    receiver = await transfer(stop)
    return receiver, receiver.finished is not None and receiver.finished.reason == "stopped"


def parse_seconds(text: str) -> float:
    """Reads a time such as 2s, 1.5 or 500ms.

    Raises:
        InvalidValueError: If it is something else.
    """
    from splatwire.errors import InvalidValueError

    match = re.fullmatch(r"([0-9]*\.?[0-9]+)\s*(ms|s|)", text.strip())
    if match is None:
        raise InvalidValueError(f"'{text}' is not a time such as 2s or 500ms")
    return float(match[1]) * (1e-3 if match[2] == "ms" else 1.0)
