"""Streams for the network: whatever packets a stream has, it is sent in packets of which each fits a datagram."""

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from splatwire.cli._output import progress_bars
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.cli._output import Reporter
    from splatwire.packets import SceneStream


def into_datagrams(stream: "SceneStream", report: "Reporter") -> "SceneStream":
    """A stream in packets that fit datagrams; tiles of levels stay as they are."""
    from splatwire.codec import repack
    from splatwire.packets import PRESETS

    packed, own = PRESETS["datagram"], stream.manifest.packetization
    if stream.manifest.schema.tiled:
        packed = replace(packed, block_size=own.block_size)
    return repack(stream, packed, progress=lambda share: report("putting it into datagrams", share))


def in_datagrams(stream: "SceneStream", path: str) -> "SceneStream":
    """A stream in packets that fit datagrams: as it is, or put into such packets, which a line on standard error tells.

    Args:
        stream: The stream.
        path: Where it was read, for the line.

    Raises:
        InvalidValueError: If it has other packets and is incomplete, or nothing is installed that packs it anew.
    """
    if stream.manifest.packetization.hashed:
        return stream
    try:
        with progress_bars() as report:
            packed = into_datagrams(stream, report)
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
