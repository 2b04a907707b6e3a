"""Options of `splatwire calibrate`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class ReferenceOptions:
    """Reference pictures for calibration; by default, renderings of the complete scene in views around it."""

    data: Path | None = None
    """Photos with poses; the training views are used."""
    cameras: Path | None = None
    """Cameras file; pictures of the complete scene from these cameras are used instead of photos."""
    background: BackgroundOption = None
    """Background colour, RGB from 0 to 1. Default: that of the stream, the scene file or the training of a 3DGS model
    folder; otherwise black."""


@dataclass(frozen=True)
class StreamCalibration:
    """Options common to `calibrate sketch` and `calibrate preview`, which add data to a stream."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Stream to write (.swz)."""
    reference_pictures: ReferenceOptions = field(default_factory=ReferenceOptions)
    seed: int = 0
    """Seed of all random choices."""
    json: JsonFlag = False
    """Print one JSON object."""


@dataclass(frozen=True)
class CalibrateGnn:
    """Train the inpainting network on one scene (--conceal gnn) and write its weights into the stream or a file."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Stream to write, with the weights in it (a name that ends in .swz), or weights file; a checkpoint goes to the
    same name with .checkpoint added."""
    preset: str = "paper"
    """paper (feature-focused), full (every attribute) or compact (few weights)."""
    bits: int | None = None
    """Bits per weight in a stream, 2 to 6; the last training steps use weights rounded to these bits. Default: 4 in a
    stream, the preset's number in a file."""
    iterations: int | None = None
    """Training steps (full and compact: maximum number). Default: 15000 for paper, as in the paper, otherwise 2000."""
    selected: bool | None = None
    """Keep the best network by held-out losses, stop early, and use interpolation for attributes that the network does
    not improve; the paper has no such rule. Default: off for paper, on for the others."""
    drop_rate: float = 0.2
    """Share of packets dropped in training."""
    distill_weight: float | None = None
    """Weight of the distance to the interpolation in the training loss, default 0.25. The paper has 0.25 for its main
    configuration and 1 for its final one."""
    render_weight: float = 0.0
    """Weight of the rendering loss. It needs --cameras; --cameras, --render-width and --background apply only to it."""
    cameras: Path | None = None
    """Cameras file."""
    render_width: int | None = None
    """Width of the rendered pictures in pixels, default 200."""
    background: BackgroundOption = None
    """Background colour, RGB from 0 to 1. Default: that of the stream, the scene file or the training of a 3DGS model
    folder; otherwise black."""
    precision: str | None = None
    """Precision of the weights in a file: float16 (default) or float32."""
    device: str = "cpu"
    """Training device: cpu, or cuda (without the rendering loss)."""
    seed: int = 0
    """Seed of all random choices."""
    resume: bool = False
    """Continue from the checkpoint next to the output."""
    json: JsonFlag = False
    """Print one JSON object."""


@dataclass(frozen=True)
class CalibrateSketch(StreamCalibration):
    """Add coarse copies of the most important elements to the stream, to conceal losses (--conceal sketch)."""

    share: float = 0.04
    """Bytes of the sketch relative to the bytes of the stream."""
    drop_rate: float = 0.2
    """Share of packets dropped when the enlargement of elements is fitted."""


@dataclass(frozen=True)
class CalibratePreview(StreamCalibration):
    """Add a preview to the stream: up to 133 Gaussians, shown before anything else has arrived."""


@dataclass(frozen=True)
class Calibrate:
    """Add a network, a sketch or a preview to the stream of a finished scene: calibrate gnn|sketch|preview."""

    addition: (
        Annotated[CalibrateGnn, tyro.conf.subcommand("gnn")]
        | Annotated[CalibrateSketch, tyro.conf.subcommand("sketch")]
        | Annotated[CalibratePreview, tyro.conf.subcommand("preview")]
    )
