"""Options of `splatwire inspect`."""

from dataclasses import dataclass

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Inspect:
    """Show the content of a stream, scene file or file of Gaussians: bytes by part, losses, bounds, problems."""

    source: tyro.conf.Positional[str]
    """Stream (a .swz file or a folder), scene file or explicit Gaussians; - for standard input."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
