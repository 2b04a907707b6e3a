"""Options of `splatwire transmit`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Transmit:
    """Simulate the transmission of a stream over a channel that loses packets."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if the name ends in .swz (or is -), otherwise a folder of packets."""
    loss: str = "bernoulli:0.2"
    """Loss model: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit of loss is a .pak
    packet."""
    seed: int = 0
    """Seed of the losses."""
    send_order: str = "interleaved"
    """Order of sending: interleaved (lane by lane, so that a burst affects many blocks), block (block by block) or
    tiers (tier by tier)."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of the stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
