"""Options of `splatwire thumb`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Thumb:
    """Draw one picture that shows a scene: its initial view, or all of it from the side with the most detail."""

    scene: tyro.conf.Positional[str]
    """Stream, scene file or explicit Gaussians (PLY, SPZ, SOG, ...); - for standard input. A clip shows its first
    frame."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Picture to write: .jpg, .png or .webp."""
    size: tuple[int, int] = (1200, 630)
    """Width and height, pixels."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
