"""Options of `splatwire decode`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag, OutliersOption


@dataclass(frozen=True)
class Decode:
    """Decode the received packets of a stream; no other file is needed."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write. Explicit Gaussians: a .ply, .spz, .sog or .splat file. Clips: a folder."""
    conceal: str | None = None
    """Concealer for lost elements (drop, prior, idw, cari, grow, ...). Without it the losses stay marked in the scene
    file, and `render` or `evaluate` conceal them; lost explicit Gaussians are left out. Clips: drop, hold, extrapolate,
    neighbors or motion (default)."""
    frame: int | None = None
    """Clips: number of the only frame to write, to a file, or to a folder if the output's name has no suffix."""
    max_frames: int | None = None
    """Clips: maximum number of frames to write, one file each; default 20000."""
    format: str | None = None
    """Clips: format of the files: ply (default), compressed.ply, spz, sog or splat."""
    outliers: OutliersOption = None
    """Treatment of Gaussians whose distant positions or extreme values would reduce the precision of all others in an
    .spz, .sog or .compressed.ply file: clamp (default) moves them to the limits of the other values, prune leaves them
    out, keep writes them unchanged."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
