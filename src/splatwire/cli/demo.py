"""Options of `splatwire demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Demo:
    """Drop 20 % of the packets of a real scene, conceal the losses, measure the quality, and write a report."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("splatwire-demo")
    """Folder for the report."""
    loss: str = "bernoulli:0.2"
    """Loss model: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit of loss is a .pak
    packet."""
    seed: int = 0
    """Seed of the losses."""
    views: int | None = None
    """Maximum number of views, evenly spaced. Default: all."""
    json: JsonFlag = False
    """Print one JSON object."""
