"""Options of `splatwire export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag, OutliersOption


@dataclass(frozen=True)
class Export:
    """Export a scene as explicit Gaussians, which common splat viewers open; the loss of quality is measured."""

    kind: tyro.conf.Positional[str]
    """ply, compressed-ply, spz, sog, splat, glb, or a format of an installed package. ply is the format of 3DGS;
    compressed-ply, spz and sog are smaller; splat has 32 bytes per Gaussian and one colour for all directions; glb is
    glTF with KHR_gaussian_splatting."""
    scene: tyro.conf.Positional[str]
    """Scene file, decoded scene with gaps, or stream; - for standard input. Explicit Gaussians are converted."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder: anchors are fitted to its training views; its test views and photos measure the export."""
    cameras: Path | None = None
    """Cameras file with the views for fitting and measurement, instead of a dataset."""
    views: int | None = None
    """Number of views on a sphere around the scene, instead of --data and --cameras; every eighth is used only to
    measure. Default: 64 for anchors; Gaussians are measured only with --data, --cameras or --views."""
    degree: int | None = None
    """Maximum degree of the spherical harmonics, 0 to 3. Default: 3; a .splat file has only degree 0."""
    harmonic_bits: tuple[int, int] | None = None
    """SPZ: bits of harmonics of degree 1, and of higher degrees. Default: 8 8; 5 4, as written by other programs, gives
    a smaller file."""
    spz_version: int | None = None
    """SPZ: version, default 4; 3 for programs that cannot read version 4."""
    outliers: OutliersOption = None
    """Treatment of Gaussians whose distant positions or extreme values would reduce the precision of all others in
    compressed-ply, spz and sog: clamp (default) moves them to the limits of the other values, prune leaves them out,
    keep writes them unchanged."""
    conceal: str = "drop"
    """Concealer for a scene with gaps."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
