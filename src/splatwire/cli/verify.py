"""Options of `splatwire verify`."""

from dataclasses import dataclass

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Verify:
    """Check streams: container, manifest, side information, checksum of each packet, and that no packet is missing.

    Nothing is decoded. The exit status is 3 if any stream is damaged or incomplete.
    """

    streams: tyro.conf.Positional[tuple[str, ...]]
    """Streams: .swz files, .glb files with a stream, or folders; - for standard input."""
    accept_losses: bool = False
    """Accept streams with missing packets, such as the output of `transmit`; damaged bytes still fail."""
    json: JsonFlag = False
    """Print one JSON object."""
