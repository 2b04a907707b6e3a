"""`splatwire live`: frames are encoded as they appear, and sent to whoever asks."""

import asyncio
import contextlib
import gc
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._arriving import files_of, names_of_a_pipe
from splatwire.cli._files import STANDARD
from splatwire.cli._listening import Listening, check_port, open_server
from splatwire.cli._output import JsonFlag, print_json

if TYPE_CHECKING:
    from splatwire.clips import ClipOptions
    from splatwire.transport import Program, Protection
    from splatwire.transport.quic_server import QuicServer
    from splatwire.transport.udp import UdpServer

NAME = "live"
LAST_S = 3.0
"""What clients lack when the last frame was encoded is sent for so long."""


@dataclass(frozen=True)
class Live:
    """Encode frames as they appear and serve them while they do; Ctrl-C, or the end of a pipe, ends it."""

    frames: tyro.conf.Positional[str]
    """Folder that somebody writes a file a frame into, under names that sort in time; a file that is written elsewhere
    and moved in is never read half. Or -: names of such files, one a line, on standard input."""
    fps: float | None = None
    """Frames a second; 30 where absent. Frames that are there already are taken no faster."""
    group: int | None = None
    """Frames of a group, 1 to 64: what a viewer waits for, and what a lost packet of motion is missing for; 15 where
    absent."""
    quality: str | None = None
    """How finely Gaussians are quantised: small, default or near-lossless."""
    port: int = 4840
    """UDP port; 0 lets the system choose."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all of this machine's."""
    rate: float | None = None
    """Megabits per second to each client, fixed; without it the rate adapts to the path."""
    quic: bool = False
    """Serve over QUIC; browsers may come by WebTransport."""
    page: int | None = None
    """Serve a page that plays it in a browser, on this TCP port; 0 lets the system choose. Implies --quic."""
    certificate: Path | None = None
    """With --quic: certificate and its chain (PEM); without it one is made on the spot and its fingerprint told."""
    key: Path | None = None
    """Private key of the certificate (PEM, not encrypted)."""
    plan: Path | None = None
    """Parity for each group of frames, as `splatwire plan -o FILE` wrote it for a recording of something like this."""
    protect: tuple[str, ...] = ()
    """Without --plan: motion=REPAIR, repair symbols for each packet of motion."""
    json: JsonFlag = False
    """Print one JSON object when ready."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.cli._clips import clip_options
        from splatwire.errors import InvalidValueError

        check_port(self.port)
        check_port(self.page or 0)
        if self.rate is not None and not 0 < self.rate <= 100_000:
            raise InvalidValueError(f"a rate is above 0 and at most 100000 megabits per second, {self.rate} is not")
        if self.frames != STANDARD and not Path(self.frames).is_dir():
            raise InvalidValueError(f"{self.frames} is no folder that frames appear in, and not - for a pipe")
        protection = self._protection()
        asyncio.run(self._serve(clip_options(self.fps, self.group, self.quality, None), protection))

    def _protection(self) -> "Protection":
        from splatwire.cli.serve import protection_of
        from splatwire.errors import InvalidValueError
        from splatwire.plan.plan_file import MOST_BYTES, read_plan
        from splatwire.transport.broadcast import PROTECTION

        if self.plan is None:
            protection = protection_of(PROTECTION.side_repair, self.protect)
        elif self.protect:
            raise InvalidValueError("--protect is what --plan decides: give one or the other")
        else:
            with self.plan.open("rb") as file:
                protection = read_plan(file.read(MOST_BYTES + 1), str(self.plan))[0]
        if protection.tier_repair:
            raise InvalidValueError("what moves has parity for its motion, not for tiers: --protect motion=0.2")
        return protection

    def _listening(self) -> Listening:
        """Where is served.

        Raises:
            InvalidValueError: If a certificate was given and there is no session to show it.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.transport import ServerLimits

        quic = self.quic or self.page is not None
        if not quic and (self.certificate or self.key):
            raise InvalidValueError("--certificate and --key are for --quic")
        limits = ServerLimits(fixed_rate=None if self.rate is None else self.rate * 1e6 / 8)
        return Listening(self.host, self.port, quic, self.page, self.certificate, self.key, (), limits)

    async def _serve(self, options: "ClipOptions", protection: "Protection") -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop.set)
        async with contextlib.AsyncExitStack() as stack:
            listening = self._listening()
            server, facts = await open_server({}, listening, stack, NAME)
            if self.json:
                print_json({"host": self.host, "port": server.port, **facts})
            else:
                print(f"live on {'quic' if listening.quic else 'udp'}://{self.host}:{server.port}")
                for name, value in facts.items():
                    print(f"{name}: {value}")
            sys.stdout.flush()

            def renew(program: "Program") -> None:
                loop.call_soon_threadsafe(server.renew, NAME, program)

            source = (
                names_of_a_pipe(stop.is_set) if self.frames == STANDARD else files_of(Path(self.frames), stop.is_set)
            )
            frames = await asyncio.to_thread(_encode, source, options, protection, renew, stop.is_set)
            await _last(server)
            served = f"served {server.core.num_served} clients, {server.bytes_sent:,} bytes"
        print(f"{frames} frames, {served}", file=sys.stderr)


async def _last(server: "UdpServer | QuicServer") -> None:
    """Lets clients ask for what they lack; they leave when they have it."""
    end = time.monotonic() + LAST_S
    while server.core.num_transfers and time.monotonic() < end:
        await asyncio.sleep(0.05)


def _encode(
    files: Iterator[Path | None], options: "ClipOptions", protection: "Protection",
    renew: "Callable[[Program], None]", stop: Callable[[], bool],
) -> int:  # fmt: skip
    """Encodes frames at their rate, and hands on what is served after each group; how many they were."""
    from splatwire.clips import read_frames
    from splatwire.clips.chapters import EndlessClip

    clip = EndlessClip(options, lambda: int.from_bytes(os.urandom(4), "little"), protection)
    due, behind = time.monotonic(), options.group_frames / float(options.rate)
    for path in files:
        if stop():
            break
        if path is None:
            continue
        due = max(due, time.monotonic() - behind)  # what coding a group takes is made up for, a pause is not
        edition = clip.push(next(read_frames([path])))
        if clip.num_frames == options.group_frames:
            gc.freeze()  # to look at all that modules and kernels made would hold a group up by a tenth of a second
        if edition is not None:
            renew(edition)
        due += 1 / float(options.rate)
        time.sleep(max(due - time.monotonic(), 0.0))
    for edition in clip.end():
        renew(edition)
    return clip.num_frames
