"""`splatwire live`: frames are encoded as they appear, and sent to whoever asks."""

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._arriving import FolderSource, FrameSource, PipeSource
from splatwire.cli._background import first_of, start_thread
from splatwire.cli._files import STANDARD
from splatwire.cli._listening import Listening, open_server, stop_on_signals
from splatwire.cli._live_encoding import LiveEncoding, Warnings, few_warnings, new_stream_id, print_if_read

if TYPE_CHECKING:
    from splatwire.clips import ClipOptions
    from splatwire.transport import Program, Protection
    from splatwire.transport.quic_server import QuicServer
    from splatwire.transport.udp import UdpServer

NAME = "live"
LAST_S = 3.0
"""What clients lack when the last frame was encoded is sent for so long."""
STOP_S = 10.0
"""Longest time that the encoder has to end after Ctrl-C, seconds: a file it reads may never come."""
STUCK = 1
"""Exit status if the encoder did not end."""


@dataclass(frozen=True)
class Live(Listening):
    """Encode frames as they appear and serve them while they do; Ctrl-C, or the end of a pipe, ends it."""

    frames: tyro.conf.Positional[str]
    """Folder that a file for each frame is written into, under names that sort in time; or -: names of such files, one
    a line, on standard input. Frames that cannot be read are skipped, and frames that come faster than they are encoded
    are dropped; both are reported. Files that are written elsewhere and moved in are never read half."""
    fps: float | None = None
    """Frames a second; 30 where absent. Frames that are there already are taken no faster."""
    group: int | None = None
    """Frames of a group, 1 to 64: what a viewer waits for, and what a lost packet of motion is missing for; 15 where
    absent."""
    quality: str | None = None
    """How finely Gaussians are quantised: small, default or near-lossless."""
    plan: Path | None = None
    """Parity for each group of frames, as `splatwire plan -o FILE` wrote it for a recording of something like this."""
    protect: tuple[str, ...] = ()
    """Without --plan: motion=REPAIR, repair symbols for each packet of motion."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.cli._clips import clip_options
        from splatwire.errors import InvalidValueError

        self.check_listening()
        if self.frames != STANDARD and not Path(self.frames).is_dir():
            raise InvalidValueError(f"{self.frames} is no folder that frames appear in, and not - for a pipe")
        protection = self._protection()
        if not asyncio.run(self._serve(clip_options(self.fps, self.group, self.quality, None), protection)):
            os._exit(STUCK)  # the interpreter would wait for threads of the encoder, which may never end

    def _protection(self) -> "Protection":
        from splatwire.cli.serve import plan_of_file, protection_of
        from splatwire.errors import InvalidValueError
        from splatwire.transport.broadcast import PROTECTION

        if self.plan is None:
            protection = protection_of(PROTECTION.side_repair, self.protect)
        elif self.protect:
            raise InvalidValueError("--protect is what --plan decides: give one or the other")
        else:
            protection = plan_of_file(self.plan)[0]
        if protection.tier_repair:
            raise InvalidValueError("what moves has parity for its motion, not for tiers: --protect motion=0.2")
        return protection

    async def _serve(self, options: "ClipOptions", protection: "Protection") -> bool:
        """Serves until a signal, or the end of the frames; returns False if the encoder had to be left alone."""
        from splatwire.transport import ServerLimits

        stop, loop, warn = stop_on_signals(), asyncio.get_running_loop(), Warnings()
        async with contextlib.AsyncExitStack() as stack:
            limits = ServerLimits(fixed_rate=self.fixed_rate)
            opened = await open_server({}, self, limits, stack, live=NAME)
            server = opened.server
            self.tell_ready(server.port, opened.facts, "live")

            def renew(program: "Program") -> None:
                loop.call_soon_threadsafe(server.renew, NAME, program)

            work = self._encoding(options, protection, renew, stop.is_set, warn)
            with few_warnings(warn):
                encoding = start_thread(work.run, "encoding")
                await first_of(encoding, stop, STOP_S)
            if encoding.done():
                encoding.result()
                await _last(server)
            else:
                warn(f"the encoder did not end within {STOP_S:g} s: left alone")
        left_out = f", {work.num_skipped:,} skipped, {work.num_dropped:,} dropped"
        print_if_read(f"{work.num_frames} frames{left_out}, {opened.served()}")
        return encoding.done()

    def _encoding(
        self, options: "ClipOptions", protection: "Protection", renew: "Callable[[Program], None]",
        stop: Callable[[], bool], warn: Warnings,
    ) -> LiveEncoding:  # fmt: skip
        from splatwire.clips.chapters import EndlessClip

        source: FrameSource
        if self.frames == STANDARD:
            source = PipeSource(sys.stdin.fileno(), warn)
        else:
            source = FolderSource(Path(self.frames), warn)
        clip = EndlessClip(options, new_stream_id, protection)
        return LiveEncoding(source, clip, options, renew, stop, warn)


async def _last(server: "UdpServer | QuicServer") -> None:
    """Lets clients ask for what they lack; they leave when they have it."""
    end = time.monotonic() + LAST_S
    while server.core.num_transfers and time.monotonic() < end:
        await asyncio.sleep(0.05)
