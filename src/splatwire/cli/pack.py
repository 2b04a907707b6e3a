"""Options of `splatwire pack`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Pack:
    """Write one HTML file that shows streams in a browser; it needs nothing else, not even a network.

    If the name of the output ends in .glb, write one glTF file instead. It contains the stream of explicit Gaussians
    (draft extension EXT_splatwire), and a few thousand Gaussians for programs that cannot read streams.
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    """Streams of explicit Gaussians or of the causal model: .swz files or folders; - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """HTML or glTF file to write; - for HTML on standard output."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
