"""Options of `splatwire study`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class StudyCommand:
    """Run a protocol file: scenes, rows, losses and seeds. Finished units of work are not computed again."""

    protocol: tyro.conf.Positional[Path]
    """Protocol file (.toml), as in benchmarks/paper."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for records, tables and the report; finished work is in its folder store."""
    scene: str | None = None
    """Stream, scene file or model folder, or the word bundled, instead of the protocol's scenes."""
    photos: Path | None = None
    """Dataset folder of --scene. Default: --cameras, with renders of the scene as references."""
    cameras: Path | None = None
    """Cameras file of --scene."""
    weights: Path | None = None
    """Calibrated GNN weights of --scene."""
    seeds: tuple[int, ...] = ()
    """Seeds of the loss masks, one transmission for each, instead of the protocol's."""
    views: int | None = None
    """Maximum number of views, evenly spaced, instead of the protocol's."""
    lpips_views: int | None = None
    """Maximum number of views for LPIPS, which is slow on a CPU, instead of the protocol's."""
    renderer: str | None = None
    """Renderer: cpu, reference or gsplat, instead of the protocol's."""
    engine: str = "local"
    """Execution of the units: local (processes), ray (RAY_ADDRESS or a local cluster) or slurm."""
    workers: int | None = None
    """Number of parallel workers. Default: one per processor."""
    partition: str | None = None
    """With --engine slurm: partition."""
    account: str | None = None
    """With --engine slurm: account."""
    minutes: int | None = None
    """With --engine slurm: time limit of a job in minutes, default 240."""
    memory_gb: int | None = None
    """With --engine slurm: memory of a job in GB, default 8."""
    json: JsonFlag = False
    """Print one JSON object."""
