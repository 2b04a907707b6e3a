"""Streams for the network: whatever packets a stream has, it is sent in packets of which each fits a datagram."""

import sys
from typing import TYPE_CHECKING

from splatwire.cli._output import progress_bars

if TYPE_CHECKING:
    from splatwire.packets import SceneStream


def in_datagrams(stream: "SceneStream", path: str) -> "SceneStream":
    """A stream in packets that fit datagrams: as it is, or put into such packets, which a line on standard error tells.

    Args:
        stream: The stream.
        path: Where it was read, for the line.

    Raises:
        InvalidValueError: If it has other packets and is incomplete.
    """
    if stream.manifest.packetization.hashed:
        return stream
    from splatwire.codec import repack
    from splatwire.packets import PRESETS

    with progress_bars() as report:
        packed = repack(stream, PRESETS["datagram"], progress=lambda share: report("putting it into datagrams", share))
    growth = packed.num_bytes / stream.num_bytes - 1
    print(
        f"{path}: the same scene in {len(packed.packets):,} packets that fit datagrams, {growth:+.1%} bytes; "
        "`encode --preset datagram` does that beforehand",
        file=sys.stderr,
    )
    return packed
