"""How much memory decoding takes at most: in proportion to the bytes that are there, so that few bytes cannot take all.

Side information announces elements, and a packet may hold thousands of them in no byte at all (a decoder reads zeros
behind its end). So decoders say what they will hold, and how much each of their threads works with, before they
allocate it. Real streams need a tenth of what is allowed here, and where most of one is lost, `FREE_BYTES` are enough
for a million anchors or Gaussians.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.ops.threads import allowed_threads
from splatwire.packets.limits import BYTES_PER_BYTE, FREE_BYTES

MOST_BYTES = 8 << 30
"""Allowed at most, and where nobody knows how large a stream will be that has only begun to arrive."""
VARIABLE = "SPLATWIRE_DECODE_GB"
"""Environment variable that replaces all of these limits: a number of gigabytes."""


def allowed_bytes(stream_bytes: int | None) -> int:
    """Memory that decoding may take.

    Args:
        stream_bytes: Bytes of the stream that are there; None for one that is yet to arrive.

    Raises:
        InvalidValueError: If the environment says something that is no number of gigabytes.
    """
    text = os.environ.get(VARIABLE)
    if text is not None:
        try:
            gigabytes = float(text)
        except ValueError:
            gigabytes = -1.0
        if not 0 < gigabytes < 1e6:
            raise InvalidValueError(f"{VARIABLE} is a number of gigabytes above 0, not {text[:40]!r}")
        return int(gigabytes * 1e9)
    return MOST_BYTES if stream_bytes is None else min(FREE_BYTES + BYTES_PER_BYTE * stream_bytes, MOST_BYTES)


def check_memory(needed: int, stream_bytes: int | None, what: str) -> None:
    """Refuses what would take more memory than a stream may.

    Args:
        needed: Bytes of memory.
        stream_bytes: See `allowed_bytes`.
        what: What takes them, for the error message.

    Raises:
        BitstreamError: If it is too much; the message says how to allow it.
    """
    allowed = allowed_bytes(stream_bytes)
    if needed > allowed:
        size = "a stream" if stream_bytes is None else f"a stream of {stream_bytes:,} bytes"
        raise BitstreamError(
            f"{what} would take {needed / 1e9:.2f} GB of memory, and {size} may take {allowed / 1e9:.2f} GB: "
            f"set {VARIABLE}={needed / 1e9 + 0.01:.2f} in the environment to allow it"
        )


def threads_within(held: int, working: int, stream_bytes: int | None, what: str, threads: int | None = None) -> int:
    """How many threads can work in the memory that a stream may take.

    Args:
        held: Bytes of memory that are held whatever the number of threads.
        working: Bytes that each thread works with.
        stream_bytes: See `allowed_bytes`.
        what: What takes them, for the error message.
        threads: Most threads; None for as many as there may be.

    Raises:
        BitstreamError: If there is not enough for one.
    """
    check_memory(held + working, stream_bytes, what)
    room = (allowed_bytes(stream_bytes) - held) // max(working, 1)
    return max(1, min(threads or allowed_threads(), room))


@contextmanager
def allocating(what: str) -> Iterator[None]:
    """Turns a failed allocation into an error of the stream that asked for it.

    Raises:
        BitstreamError: If the machine has not enough memory.
    """
    try:
        yield
    except MemoryError as error:
        raise BitstreamError(f"{what} takes more memory than there is here") from error
    except RuntimeError as error:
        if "allocate memory" not in str(error):  # torch's allocator has no error of its own
            raise
        raise BitstreamError(f"{what} takes more memory than there is here") from error
