"""Options of `splatwire evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class Evaluate:
    """Measure the quality of a stream or scene: drop packets, conceal, render the test views, and compare."""

    source: tyro.conf.Positional[str]
    """Stream (complete or with losses), scene file or explicit Gaussians (used unchanged; with --loss they are encoded
    first); - for standard input."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder; its test photos are the references, within their masks if they have any."""
    reference: Path | None = None
    """Scene file, stream, or explicit Gaussians (PLY, SPZ, SOG, ...) whose renders are the references, not
    photos; for a clip the folder of its frames."""
    cameras: Path | None = None
    """Cameras file for --reference. Default: cameras of --data, or views around the reference."""
    path: Path | None = None
    """Cameras file: measure PSNR over time along its cameras while a stream with levels arrives over a simulated link.
    """
    rate: str | None = None
    """With --path: rate of the simulated link in bits per second, such as 10M or 800k."""
    delay: float | None = None
    """With --path: delay of the simulated link in each direction, milliseconds; default 20."""
    seconds: float | None = None
    """With --path: duration of the walk, seconds; default: one second from each camera to the next."""
    loss: str | None = None
    """Loss model: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit of loss is a .pak
    packet. Without it the source is evaluated unchanged."""
    seeds: tuple[int, ...] = ()
    """Seeds of the loss masks, one transmission for each; all concealers get the same losses. Default: 0."""
    conceal: tuple[str, ...] = ()
    """Concealers to compare. Default: all."""
    contiguous: bool = False
    """Add a row for packets of contiguous anchors, without concealment."""
    renderer: str = "cpu"
    """Renderer: cpu, reference or gsplat."""
    background: BackgroundOption = None
    """Background colour, RGB from 0 to 1. Default: that of the stream, the scene file or the training of a 3DGS model
    folder; otherwise black."""
    views: int | None = None
    """Maximum number of views, evenly spaced. Default: all."""
    lpips_views: int | None = None
    """Maximum number of views for LPIPS, which is slow on a CPU. Default: all."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for an HTML report with pictures."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
