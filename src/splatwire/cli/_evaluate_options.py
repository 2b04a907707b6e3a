"""Options of `splatwire evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._output import JsonFlag
from splatwire.cli._scenes import BackgroundOption


@dataclass(frozen=True)
class EvaluateOptions:
    """What is scored, and under which losses."""

    source: tyro.conf.Positional[str]
    """Stream (complete or with losses), scene file or explicit Gaussians (as they are; with --loss they are encoded
    first); - for standard input."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder: its test photos are the references, inside their masks where they have some."""
    reference: Path | None = None
    """Scene file, stream, or explicit Gaussians (PLY, SPZ, SOG, ...) whose renders are the references, not
    photos; for a clip the folder of its frames."""
    cameras: Path | None = None
    """Cameras file for --reference; without it those of --data, or views around the reference."""
    path: Path | None = None
    """Cameras file: a walk through a stream with levels while it arrives over a simulated link. PSNR over time."""
    rate: str | None = None
    """Of the link of --path, bits per second: 10M, 800k."""
    delay: float | None = None
    """Of one way of that link, milliseconds; 20 where absent."""
    seconds: float | None = None
    """How long the walk takes; a second from each camera to the next where absent."""
    loss: str | None = None
    """What is lost: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit is a .pak.
    Without it the source is scored as it is."""
    seeds: tuple[int, ...] = ()
    """One transmission per seed; all methods meet the same losses. Seed 0 where absent."""
    conceal: tuple[str, ...] = ()
    """Concealers to compare; all where absent."""
    contiguous: bool = False
    """Add a row for packets of contiguous anchors, without concealment."""
    renderer: str = "cpu"
    """cpu, reference or gsplat."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    views: int | None = None
    """Most views, spread evenly; all where absent."""
    lpips_views: int | None = None
    """Most views that LPIPS is computed on (slow on a CPU); all where absent."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for an HTML report with pictures."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""
