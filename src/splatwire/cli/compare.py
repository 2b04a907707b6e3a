"""Options of `splatwire compare`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class Compare:
    """Compare files of one scene: bytes, quality against a reference in held-out views, decoding time."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Two or more streams, scene files or files of explicit Gaussians (PLY, SPZ, SOG, ...); one with --reference."""
    reference: Path | None = None
    """File that is rendered for the references. Default: the first file."""
    cameras: Path | None = None
    """Cameras file. Default: 15 views around the reference that no encoder fits."""
    views: int | None = None
    """Maximum number of views, spread evenly. Default: all."""
    renderer: str = "cpu"
    """Renderer: cpu, reference or gsplat."""
    background: BackgroundOption = None
    """Background colour of all pictures, RGB from 0 to 1. Default: that of the reference."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for an HTML report with pictures and difference pictures."""
    json: JsonFlag = False
    """Print one JSON object."""
