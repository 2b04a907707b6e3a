"""Implementation of `splatwire live`: encodes the frames of a clip as they appear, and serves the stream to clients."""

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splatwire.cli._background import wait_for_work
from splatwire.cli._files import STANDARD
from splatwire.cli._listening import check_listening, open_server, print_ready, stop_on_signals
from splatwire.cli._live_warnings import Warnings, print_if_read, rate_limited_warnings
from splatwire.cli._protection import plan_of_file, protection_of
from splatwire.cli._sequence_options import sequence_options
from splatwire.cli.live import Live
from splatwire.errors import InvalidValueError
from splatwire.ops.compiled import is_compiling
from splatwire.sequence import SequenceOptions
from splatwire.sequence.frame_sources import FolderSource, FrameSource, PipeSource
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.sequence.live_ingest import LiveIngest, new_stream_id
from splatwire.transport import Protection, ServedStream, ServerLimits
from splatwire.transport.daemon_thread import start_thread
from splatwire.transport.protocol.live_packager import PROTECTION
from splatwire.transport.running_server import RunningServer

STREAM_NAME = "live"
DRAIN_TIMEOUT_S = 3.0
"""Maximum time that clients can request lost packets after the last frame was encoded, seconds."""
STOP_TIMEOUT_S = 10.0
"""Maximum time for the encoder to end after Ctrl-C, seconds; it may be blocked by reading a file."""
COMPILING_TIMEOUT_S = 2.0
"""Maximum time for an encoder that compiles kernels to end after Ctrl-C, seconds."""
EXIT_STUCK = 1
"""Exit status if the encoder did not end in time, although it compiled nothing."""


def run(command: Live) -> None:
    """Runs `splatwire live`: encodes and serves frames as they appear."""
    check_listening(command)
    if command.frames != STANDARD and not Path(command.frames).is_dir():
        raise InvalidValueError(
            f"{command.frames} is not a folder: give the folder of the frames, or - for file names on standard input"
        )
    protection = _protection(command)
    status = asyncio.run(
        _serve(command, sequence_options(command.fps, command.group, command.quality, None), protection)
    )
    if status is not None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)  # the interpreter would wait for threads of the encoder, which may never end


def _protection(command: Live) -> Protection:
    if command.plan is None:
        protection = protection_of(PROTECTION.init_repair, command.protect)
    elif command.protect:
        raise InvalidValueError("--plan sets the protection: give either --plan or --protect")
    else:
        protection = plan_of_file(command.plan)[0]
    if protection.tier_repair:
        raise InvalidValueError("a clip has parity for motion packets, not for tiers: --protect motion=0.2")
    return protection


async def _serve(command: Live, options: SequenceOptions, protection: Protection) -> int | None:
    """Encodes and serves the frames of a clip until the last frame was sent, or until SIGINT or SIGTERM.

    After a signal, the encoder gets a few seconds to end.

    Returns:
        None if the encoder has ended. Otherwise the encoder's thread still runs, and the result is the exit status with
        which the caller must end the process at once: 0 if the encoder is compiling kernels, else `EXIT_STUCK`.
    """
    loop, warn = asyncio.get_running_loop(), Warnings()
    async with contextlib.AsyncExitStack() as stack:
        stop = stack.enter_context(stop_on_signals())
        limits = ServerLimits(
            command.clients,
            command.clients_per_address,
            fixed_rate=command.fixed_rate,
            total_rate=command.total_bytes_s,
        )
        running = await open_server({}, command, limits, stack, live=STREAM_NAME)
        server = running.server
        print_ready(command, server.port, running.facts, "live")

        def publish(state: ServedStream) -> None:
            loop.call_soon_threadsafe(server.set_stream, STREAM_NAME, state)

        ingest = _live_ingest(command, options, protection, publish, stop.is_set, warn)
        with rate_limited_warnings(warn):
            ingest_future = start_thread(ingest.run, "encoding")
            await wait_for_work(ingest_future, stop, min(COMPILING_TIMEOUT_S, STOP_TIMEOUT_S))
            compiles = await _is_compiling_at_end(ingest_future)
        if ingest_future.done():
            ingest_future.result()
            await _await_last_packets(running)
        elif compiles:
            warn("stopped while kernels were compiled: the frames since the last group were not sent")
        else:
            warn(f"the encoder did not end within {STOP_TIMEOUT_S:g} s and was abandoned")
    left_out = f", {ingest.num_skipped:,} skipped, {ingest.num_dropped:,} dropped"
    print_if_read(f"{ingest.num_frames} frames{left_out}, {running.served()}")
    if ingest_future.done():
        return None
    return 0 if compiles else EXIT_STUCK


def _live_ingest(
    command: Live, options: SequenceOptions, protection: Protection, publish: Callable[[ServedStream], None],
    stop: Callable[[], bool], warn: Warnings,
) -> LiveIngest:  # fmt: skip
    source: FrameSource
    if command.frames == STANDARD:
        source = PipeSource(sys.stdin.fileno(), warn)
    else:
        source = FolderSource(Path(command.frames), warn)
    encoder = LiveEncoder(options, new_stream_id, protection)
    return LiveIngest(source, encoder, options, publish, stop, warn)


async def _is_compiling_at_end(ingest_future: "asyncio.Future[Any]") -> bool:
    """Waits, after a stop request, until the encoder ends, starts to compile kernels, or exceeds a time limit.

    Args:
        ingest_future: Result of the encoder's thread.

    Returns:
        True if the encoder is compiling kernels, which takes too long to wait for. False if the encoder has ended, or
        the time limit has passed.
    """
    # Compiling takes too long to wait for.
    end = time.monotonic() + STOP_TIMEOUT_S - COMPILING_TIMEOUT_S
    while not ingest_future.done():
        if is_compiling():
            return True
        if (remaining := end - time.monotonic()) <= 0:
            return False
        await asyncio.wait({ingest_future}, timeout=min(remaining, 0.1))
    return False


async def _await_last_packets(running: RunningServer) -> None:
    """Waits, for a limited time, until clients have received the last packets."""
    end = time.monotonic() + DRAIN_TIMEOUT_S
    while running.server.core.num_transfers and time.monotonic() < end:
        await asyncio.sleep(0.05)
