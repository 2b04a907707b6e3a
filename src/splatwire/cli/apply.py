"""Options of `splatwire apply`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Apply:
    """Apply an update to a stream; the result is identical, byte by byte, to the new version of the stream.

    An update is the difference between two versions of a stream. It saves the transfer of the whole new version.
    """

    stream: tyro.conf.Positional[str]
    """Complete stream that the update changes: a .swz file or a folder; - for standard input."""
    update: tyro.conf.Positional[str]
    """Update, written by `encode --update`."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if the name ends in .swz (or is -), otherwise a folder of packets."""
    json: JsonFlag = False
    """Print one JSON object."""
