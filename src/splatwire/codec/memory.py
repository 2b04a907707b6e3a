"""Memory limits of decoding, proportional to the number of received bytes.

They protect against damaged or malicious streams that announce too many elements.
"""
# A stream of few bytes can announce any number of elements. Decoders therefore compute their memory, in total and per
# thread, before allocating it. The limit is about ten times the need of real streams. It is never below `FREE_BYTES`,
# so that a stream with few received packets can be decoded, too: a scene of 600,000 Gaussians of degree 3 (244 bytes
# each), 2.4 million of degree 0 (64 bytes), or about 100,000 anchors of 50 features and 10 offsets.

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from splatwire.bitstream.limits import BYTES_PER_BYTE, FREE_BYTES
from splatwire.bitstream.packet import Packet
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.ops.threads import allowed_threads

MAX_BYTES = 8 << 30
"""Maximum memory of any stream, bytes; also the limit while the final size of a stream is unknown."""
VARIABLE = "SPLATWIRE_DECODE_GB"
"""Environment variable that overrides all of these limits: a number of gigabytes."""


def allowed_bytes(stream_bytes: int | None) -> int:
    """Returns the maximum memory for decoding a stream, bytes.

    Args:
        stream_bytes: Received bytes of the stream; None if its size is not known yet.

    Raises:
        InvalidValueError: If the environment variable `SPLATWIRE_DECODE_GB` is not a positive number of gigabytes.
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
    return MAX_BYTES if stream_bytes is None else min(FREE_BYTES + BYTES_PER_BYTE * stream_bytes, MAX_BYTES)


def check_memory(needed: int, stream_bytes: int | None, activity: str) -> None:
    """Checks a memory requirement against a stream's limit.

    Args:
        needed: Bytes of memory.
        stream_bytes: Received bytes of the stream, which determine the limit; None if its size is not known yet.
        activity: Activity that needs the memory, for the error message.

    Raises:
        BitstreamError: If the limit is exceeded.
    """
    allowed = allowed_bytes(stream_bytes)
    if needed > allowed:
        size = "a stream" if stream_bytes is None else f"a stream of {stream_bytes:,} bytes"
        raise BitstreamError(
            f"{activity} would take {needed / 1e9:.2f} GB of memory, and {size} may take {allowed / 1e9:.2f} GB: "
            f"set {VARIABLE}={needed / 1e9 + 0.01:.2f} in the environment to allow it"
        )


def threads_within(
    shared_bytes: int, thread_bytes: int, stream_bytes: int | None, activity: str, threads: int | None = None
) -> int:
    """Returns the number of threads that decoding may use within a stream's memory limit.

    Args:
        shared_bytes: Bytes of memory that decoding needs regardless of the number of threads.
        thread_bytes: Additional bytes of memory for each thread.
        stream_bytes: Received bytes of the stream, which determine the limit; None if its size is not known yet.
        activity: Activity that needs the memory, for the error message.
        threads: Upper bound; None for the number of processors.

    Raises:
        BitstreamError: If the limit is too low for one thread.
    """
    check_memory(shared_bytes + thread_bytes, stream_bytes, activity)
    num_threads = (allowed_bytes(stream_bytes) - shared_bytes) // max(thread_bytes, 1)
    return max(1, min(threads or allowed_threads(), num_threads))


def packet_reader_bytes(packets: Sequence[Packet]) -> int:
    """Returns the memory that a decoder needs for the content of the largest packet, bytes.

    It is eight times the size of the packet.
    """
    # Decoders convert a packet to overlapping 64-bit integers, one for each byte (`entropy.word_kernels.words_of`).
    return 8 * max((len(packet.data) for packet in packets), default=0)


@contextmanager
def allocating(activity: str) -> Iterator[None]:
    """Returns a context manager that reports a failed memory allocation as a `BitstreamError`.

    Args:
        activity: Activity that needs the memory, for the error message.

    Raises:
        BitstreamError: If the machine does not have enough memory.
    """
    try:
        yield
    except MemoryError as error:
        raise BitstreamError(f"{activity} takes more memory than there is here") from error
    except RuntimeError as error:
        if "allocate memory" not in str(error):  # torch's allocator raises a plain RuntimeError
            raise
        raise BitstreamError(f"{activity} takes more memory than there is here") from error
