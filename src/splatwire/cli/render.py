"""Options of `splatwire render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class Render:
    """Render a scene from every camera to PNG files; a clip is rendered to one animated picture."""

    scene: tyro.conf.Positional[str]
    """Scene file, decoded scene with gaps, stream, or explicit Gaussians (PLY, SPZ, SOG, ...); - for standard input."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the pictures and a cameras.json; for a clip a .webp file."""
    cameras: Path | None = None
    """Cameras file. Default: the test views of --data, or views around the scene. The frames of a clip use the cameras
    in turn."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder with the test views to render, instead of a cameras file."""
    scale: float = 1.0
    """Scale factor of the picture size."""
    conceal: str | None = None
    """Concealer for a scene with losses. Default: drop; motion for clips."""
    renderer: str = "cpu"
    """Renderer: cpu, reference or gsplat."""
    background: BackgroundOption = None
    """Background colour, RGB from 0 to 1. Default: that of the stream, the scene file or the training of a 3DGS model
    folder; otherwise black."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
