"""Repacking of streams for network transmission: each packet must fit into one UDP datagram."""

import sys

from splatwire.bitstream import SceneStream
from splatwire.cli._output import progress_bars
from splatwire.errors import InvalidValueError


def in_datagrams(stream: SceneStream, path: str) -> SceneStream:
    """Returns a stream in which each packet fits into one datagram. Larger packets are divided.

    Args:
        stream: The stream.
        path: Path of the stream, for messages.

    Raises:
        InvalidValueError: If the stream must be repacked but is incomplete, or its codec is not installed.
    """
    if stream.manifest.packetization.hashed:
        return stream
    try:
        from splatwire.codec import into_datagrams  # a relay lacks its libraries

        with progress_bars() as report:
            packed = into_datagrams(stream, lambda share: report("repacketizing", share))
    except ModuleNotFoundError as error:
        raise InvalidValueError(
            f"{path}: its packets do not fit datagrams: make it with `encode --preset datagram`, or install "
            f"splatwire[scenes] here, which packs it anew ({error.name} is missing)"
        ) from error
    growth = packed.num_bytes / stream.num_bytes - 1
    print(
        f"{path}: the same scene in {len(packed.packets):,} packets that fit datagrams, {growth:+.1%} bytes; "
        "`encode --preset datagram` does that beforehand",
        file=sys.stderr,
    )
    return packed
