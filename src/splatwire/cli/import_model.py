"""Options of `splatwire import`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Import:
    """Import a model of other software: neural scenes as a scene file, explicit Gaussians as a standard PLY."""

    kind: tyro.conf.Positional[Literal["hacpp", "scaffold", "splats"]]
    """Kind of model. hacpp and scaffold are model folders of the official HAC++ and Scaffold-GS code, and become a
    scene file. splats are explicit Gaussians (PLY, compressed PLY, SPZ, SOG, .splat, .ksplat, .glb); they are checked
    and written as a 3DGS PLY, which can be rendered (render), used as reference (evaluate --reference), or as the start
    of a training (train --init)."""
    model_dir: tyro.conf.Positional[Path]
    """Model folder, or file of explicit Gaussians."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file or PLY to write."""
    appearance: int | None = None
    """Scaffold-GS with an appearance embedding: number of the training camera that determines the colours."""
    json: JsonFlag = False
    """Print one JSON object."""
