"""Implementation of `splatwire receive`: receives a stream over the network and writes it to a file."""

import asyncio
import contextlib
import itertools
import re
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from splatwire.bitstream import SceneStream, write_stream
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.cli._files import STANDARD, check_empty, check_folder, output_path, prepared_output, read_report_json
from splatwire.cli._input_warnings import DAMAGED
from splatwire.cli._output import Reporter, print_json, print_summary, progress_bars
from splatwire.cli._receiving import (
    canceling_on_signals,
    print_interruption,
    print_waiting,
    print_warning,
    transfer_of,
)
from splatwire.cli._signals import StoppedError
from splatwire.cli._terminal import print_failure
from splatwire.cli.receive import Receive
from splatwire.errors import InvalidValueError, MissingSideInfoError
from splatwire.files.names import real_path
from splatwire.sequence.live_frame_writer import LiveFrameWriter
from splatwire.transport import (
    Event,
    Finished,
    PacketArrived,
    Receiver,
    ReceiverOptions,
    SideInfoArrived,
    StreamReplaced,
    Welcomed,
)
from splatwire.transport.address import Address, parse_url, without_token
from splatwire.transport.pcap import Capture
from splatwire.transport.protocol.events import Resumed

REPEATED_SIGNAL_S = 0.2
"""Time after a signal in which further ones have no effect, seconds: `timeout` sends each signal twice, and the second
one must not end the writing of what was received.
"""


def run(command: Receive) -> None:
    """Runs `splatwire receive`: receives a stream from a server and writes the scene."""
    address = parse_url(command.url)
    deadline = None if command.deadline is None else parse_seconds(command.deadline)
    viewpoint = None
    if command.camera is not None or command.conceal is not None:
        viewpoint = _decoding_module().viewpoint_of_options(command)
    options = ReceiverOptions(
        name=address.name, scene_token=address.token, deadline_s=deadline, nack=not command.no_nack, viewpoint=viewpoint
    )
    url = without_token(command.url)
    if command.follow:
        _follow(command, address, options)
        return
    moments, periods = TransferTimes(), itertools.count()
    with progress_bars() as show, _output(command) as path, LiveFrameWriter(path, command.conceal, show) as live:

        def on_event(event: Event) -> None:
            if isinstance(event, Welcomed) and event.is_live and command.explicit:
                raise InvalidValueError(
                    f"{url} is a live clip, whose frames cannot be written to {command.output}: name a folder for "
                    f"them, or a {FILE_SUFFIX} file"
                )
            writes_frames = live.writes_frames or command.conceal is not None
            if isinstance(event, Welcomed) and event.is_live and writes_frames and not live.began:
                check_folder(Path(command.output))
                check_empty(Path(command.output))
            moments.on_event(event, show)
            live.on_event(event)
            if isinstance(event, StreamReplaced) and not live.began:
                _write_period(command, event.stream, next(periods))

        receiver, signals = _transfer(command, address, options, on_event)
        stream, over = receiver.stream(), receiver.finished
        reason = over.reason if over else "stopped"
        if stream is None:
            instead = _decoding_module().keep_preview(command, receiver.preview) if receiver.preview else ""
            missing = receiver.describe_missing()
            why = f"{reason}: {missing}" if missing else reason
            nothing = MissingSideInfoError(f"{url}: no scene arrived ({why}){instead}")
            if signals and reason == "stopped":
                print_failure(str(nothing))
                raise StoppedError(signals[0])  # sets the exit status
            raise nothing
        if live.began:
            live.finish()
        elif command.conceal is None and not command.explicit:
            write_stream(stream, path)
        else:
            _decoding_module().write_scene(command, stream, path, show)
    _print_result(command, receiver, stream, reason, moments)
    if signals and reason == "stopped":
        raise StoppedError(signals[0])  # sets the exit status; the received data is already written
    num_missed = receiver.num_missed + live.num_dropped
    if not (command.partial or _is_complete(reason, live=receiver.was_live, num_missed=num_missed)):
        missing = receiver.describe_missing()
        if live.num_dropped:
            missing = f"{missing}, {live.num_dropped:,} packets were dropped".removeprefix(", ")
        print_failure(
            f"{url}: the stream is incomplete ({reason}: {missing}); "
            f"what arrived is in {command.output}. Receive it again, or accept this with --partial"
        )
        sys.exit(DAMAGED)


def _follow(command: Receive, address: Address, options: ReceiverOptions) -> None:
    """Receives a scene and its updates until the user interrupts, and writes each new version of the scene.

    Raises:
        InvalidValueError: If an option cannot be combined with `--follow`, or the first transfer is incomplete.
    """
    if command.deadline or command.partial or command.camera or command.pcap or address.scheme == "moq":
        raise InvalidValueError("--follow is for udp:// and quic://, without --deadline, --partial, --camera, --pcap")
    transfer, decoding, num_written = transfer_of(command.trust, address), _decoding_module(), 0

    async def run() -> list[int]:
        stop, began = asyncio.get_running_loop().create_future(), time.perf_counter()
        with canceling_on_signals(stop) as signals:
            await receive(stop, began)
        return signals

    async def receive(stop: asyncio.Future[None], began: float) -> None:
        nonlocal num_written

        def on_event(event: Event) -> None:
            if isinstance(event, Welcomed) and event.is_live:
                raise InvalidValueError(f"{without_token(command.url)} is a live clip: receive it without --follow")
            print_waiting(event)

        async def fetch(name: str) -> Receiver:
            report = on_event if name == address.name else print_interruption
            return await transfer(replace(options, name=name), report, stop=stop)

        async for stream in decoding.follow(fetch, address.name, print_warning):
            with _output(command) as path, progress_bars() as show:
                if command.conceal is None and not command.explicit:
                    write_stream(stream, path)
                else:
                    decoding.write_scene(command, stream, path, show)
            num_written += 1
            elements, seconds = stream.manifest.num_elements, time.perf_counter() - began
            if command.json:
                print_json({"output": command.output, "num_elements": elements, "seconds": seconds,
                            "stream_id": f"{stream.manifest.stream_id:08x}"})  # fmt: skip
                sys.stdout.flush()
            else:
                text = f"{elements:,} {stream.manifest.elements} after {seconds:.2f} s -> {command.output}"
                print_summary(text, command.output)

    signals = asyncio.run(run())
    if not num_written:
        # Stopped before the scene arrived; sets the exit status.
        raise StoppedError(signals[0] if signals else signal.SIGINT)


def _decoding_module() -> ModuleType:
    """Imports the module that decodes received streams."""
    # Deferred, because an installation that only relays streams lacks the libraries of this module.
    from splatwire.cli import _received_scenes

    return _received_scenes


def _transfer(
    command: Receive, address: Address, options: ReceiverOptions, on_event: Callable[[Event], None]
) -> tuple[Receiver, list[int]]:
    """Receives the stream, and writes all datagrams to a capture file (pcap) if requested.

    Args:
        command: Options of `splatwire receive`.
        address: Address of the server.
        options: Options of the receiver.
        on_event: Called with each event of the transfer.

    Returns:
        The receiver, and the numbers of the received signals, which stop the transfer.
    """
    transfer = transfer_of(command.trust, address)
    with contextlib.ExitStack() as stack:
        tap = None
        if command.pcap is not None:
            capture = Capture(stack.enter_context(command.pcap.open("wb")).write)
            tap = lambda source, target, data: capture.add(source, target, data, time.time())  # noqa: E731
        return asyncio.run(_stoppable(lambda stop: transfer(options, on_event, tap=tap, stop=stop)))


def _write_period(command: Receive, stream: SceneStream, number: int) -> None:
    """Writes one period of an endless live clip to a stream file, whose name contains the number of the period.

    A live clip is divided into periods, each of which is an independent stream. If the output is standard output, the
    period is dropped, with a warning for the first one.

    Args:
        command: Options of `splatwire receive`.
        stream: Stream of the period.
        number: Number of the period.
    """
    # The last period is written to the regular output.
    if command.output == STANDARD:
        if not number:
            print_warning(
                "the live clip has several periods, and only the last one goes to standard output: name a "
                f"{FILE_SUFFIX} file to keep all"
            )
        return
    path = prepared_output(real_path(Path(command.output)).with_suffix(f".{number:03}{FILE_SUFFIX}"))
    write_stream(stream, path)


def _output(command: Receive) -> contextlib.AbstractContextManager[Path]:
    suffix = Path(command.output).suffix if command.explicit else FILE_SUFFIX if command.conceal is None else ""
    return output_path(command.output, expected_suffix=suffix, json=command.json)


def _print_result(
    command: Receive, receiver: Receiver, stream: SceneStream, reason: str, moments: "TransferTimes"
) -> None:
    report, collector = receiver.report(), receiver.collector
    assert report is not None
    assert collector is not None
    if command.json:
        print_json(
            {
                "output": command.output,
                "finished": reason,
                "packets_missed": receiver.num_missed,
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
        print_summary(f"{text} -> {command.output}", command.output)


def _is_complete(reason: str, *, live: bool, num_missed: int) -> bool:
    """True if a transfer delivered all data that the user requested.

    Args:
        reason: Reason for the end of the transfer. `complete`: everything arrived. `seen`: everything that the
            receiver's camera sees arrived. `sent`: the server has sent everything. Other reasons are failures.
        live: True for a live clip.
        num_missed: Number of packets of a live clip that were lost.
    """
    # A stream with levels of detail is complete if everything that the camera sees arrived. A live clip is complete if
    # the server ended it and everything sent since this receiver joined arrived.
    over = reason in ("complete", "seen") or (reason == "sent" and live)
    return over and not num_missed


class TransferTimes:
    """Measures when the first events of a transfer happen, in seconds since its start."""

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self._packets = 0
        self._expected = 1
        self.preview: float | None = None
        self.side_info: float | None = None
        self.end: float | None = None

    def seconds(self) -> float:
        """Returns the duration of the transfer, seconds."""
        return time.perf_counter() - self._began if self.end is None else self.end

    def on_event(self, event: Event, show: Reporter) -> None:
        """Records the time of an event of the receiver, and reports the progress.

        Args:
            event: The event.
            show: Called with the name of the task and the received share of the packets, 0 to 1.
        """
        print_waiting(event)
        match event:
            case Welcomed():
                self._expected = max(event.num_packets, 1)
                if event.preview and self.preview is None:
                    self.preview = time.perf_counter() - self._began
            case Resumed():
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
    transfer: Callable[[asyncio.Future[None]], Awaitable[Receiver]],
) -> tuple[Receiver, list[int]]:
    """Runs a transfer until the transfer ends, or until SIGINT or SIGTERM.

    Returns:
        The receiver, and the numbers of the received signals.
    """
    stop = asyncio.get_running_loop().create_future()
    with canceling_on_signals(stop) as signals:
        receiver = await transfer(stop)
        if signals:
            await asyncio.sleep(REPEATED_SIGNAL_S)
        return receiver, signals


def parse_seconds(text: str) -> float:
    """Parses a duration such as `2s`, `1.5` or `500ms`, and returns seconds.

    Raises:
        InvalidValueError: If the text is not a time.
    """
    match = re.fullmatch(r"([0-9]*\.?[0-9]+)\s*(ms|s|)", text.strip())
    if match is None:
        raise InvalidValueError(f"'{text}' is not a time such as 2s or 500ms")
    return float(match[1]) * (1e-3 if match[2] == "ms" else 1.0)
