"""`splatwire live`: frames are encoded as they appear, and sent to whoever asks."""

import asyncio
import contextlib
import gc
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._files import STANDARD
from splatwire.cli._output import JsonFlag, print_json

if TYPE_CHECKING:
    from splatwire.clips import ClipOptions
    from splatwire.transport import Program, Protection
    from splatwire.transport.udp import UdpServer

NAME = "live"
LOOK_S = 0.02
"""A folder is looked at so often."""
LAST_S = 3.0
"""What clients lack when the last frame was encoded is sent for so long."""


@dataclass(frozen=True)
class Live:
    """Encode frames as they appear and serve them over UDP while they do; Ctrl-C, or the end of a pipe, ends it."""

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

        if not 0 <= self.port < 1 << 16:
            raise InvalidValueError(f"a port is a number from 0 to 65535, {self.port} is not")
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

    async def _serve(self, options: "ClipOptions", protection: "Protection") -> None:
        from splatwire.transport import ServerLimits
        from splatwire.transport.udp import UdpServer

        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop.set)
        limits = ServerLimits(fixed_rate=None if self.rate is None else self.rate * 1e6 / 8)
        server = UdpServer({}, self.host, self.port, limits=limits)
        with contextlib.closing(server):
            if self.json:
                print_json({"host": self.host, "port": server.port})
            else:
                print(f"live on udp://{self.host}:{server.port}")
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


async def _last(server: "UdpServer") -> None:
    """Lets clients ask for what they lack; they leave when they have it."""
    end = time.monotonic() + LAST_S
    while server.core.num_transfers and time.monotonic() < end:
        await asyncio.sleep(0.05)


def _encode(
    files: Iterator[Path | None], options: "ClipOptions", protection: "Protection",
    renew: "Callable[[Program], None]", stop: Callable[[], bool],
) -> int:  # fmt: skip
    """Encodes frames at their rate, and hands on what is served after each group; how many they were."""
    from splatwire.clips import ClipEncoder, read_frames
    from splatwire.transport.broadcast import Broadcast

    encoder, count = ClipEncoder(options), 0
    broadcast = Broadcast(protection, encoder.worth)
    stream_id = int.from_bytes(os.urandom(4), "little")
    due, behind = time.monotonic(), options.group_frames / float(options.rate)
    for path in files:
        if stop():
            break
        if path is None:
            continue
        due = max(due, time.monotonic() - behind)  # what coding a group takes is made up for, a pause is not
        packets = encoder.push(next(read_frames([path])))
        count += 1
        if count == options.group_frames:
            gc.freeze()  # to look at all that modules and kernels made would hold a group up by a tenth of a second
        if count % options.group_frames == 0:
            renew(broadcast.add(*encoder.so_far(stream_id), packets))
        due += 1 / float(options.rate)
        time.sleep(max(due - time.monotonic(), 0.0))
    if count % options.group_frames:
        packets = encoder.flush()
        renew(broadcast.add(*encoder.so_far(stream_id), packets))
    if count:
        renew(broadcast.end(*encoder.so_far(stream_id)))
    return count


def names_of_a_pipe(stop: Callable[[], bool]) -> Iterator[Path | None]:
    """Files named on standard input, one a line, until it ends; None while nothing comes.

    Args:
        stop: Whether to end.
    """
    source, rest = sys.stdin.fileno(), b""
    while not stop():
        if not select.select([source], [], [], LOOK_S)[0]:
            yield None
            continue
        some = os.read(source, 1 << 16)
        *lines, rest = (rest + (some or b"\n")).split(b"\n")
        yield from (Path(os.fsdecode(line.strip())) for line in lines if line.strip())
        if not some:
            return


def files_of(folder: Path, stop: Callable[[], bool]) -> Iterator[Path | None]:
    """Frames of a folder, each as soon as it is there and has stopped growing; None while nothing new is.

    Args:
        folder: The folder.
        stop: Whether to end.
    """
    from splatwire.clips.frames import by_number, is_frame

    done: set[str] = set()
    sizes: dict[str, tuple[int, int]] = {}
    while not stop():
        new = sorted((path for path in folder.iterdir() if path.name not in done), key=by_number)
        ready = [path for path in new if _settled(path, sizes) and is_frame(path)]
        for path in ready:
            done.add(path.name)
            yield path
        if not ready:
            time.sleep(LOOK_S)
            yield None


def _settled(path: Path, sizes: dict[str, tuple[int, int]]) -> bool:
    """Whether a file is as it was when it was last looked at, a moment ago."""
    try:
        facts = path.stat()
    except OSError:  # it was moved away
        return False
    now = (facts.st_size, facts.st_mtime_ns)
    before = sizes.get(path.name)
    sizes[path.name] = now
    return before == now or (before is None and time.time() - facts.st_mtime > 1.0)
