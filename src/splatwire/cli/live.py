"""`splatwire live`: frames are encoded as they appear, and sent to whoever asks."""

import asyncio
import contextlib
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._arriving import files_of, names_of_a_pipe
from splatwire.cli._files import STANDARD
from splatwire.cli._listening import Listening, open_server, stop_on_signals

if TYPE_CHECKING:
    from splatwire.clips import ClipOptions
    from splatwire.transport import Program, Protection
    from splatwire.transport.quic_server import QuicServer
    from splatwire.transport.udp import UdpServer

NAME = "live"
LAST_S = 3.0
"""What clients lack when the last frame was encoded is sent for so long."""


@dataclass(frozen=True)
class Live(Listening):
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
        asyncio.run(self._serve(clip_options(self.fps, self.group, self.quality, None), protection))

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

    async def _serve(self, options: "ClipOptions", protection: "Protection") -> None:
        from splatwire.transport import ServerLimits

        stop, loop = stop_on_signals(), asyncio.get_running_loop()
        async with contextlib.AsyncExitStack() as stack:
            limits = ServerLimits(fixed_rate=self.fixed_rate)
            server, facts = await open_server({}, self, limits, stack, live=NAME)
            self.tell_ready(server.port, facts, "live")

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
