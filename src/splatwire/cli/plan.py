"""Options of `splatwire plan`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class PlanCommand:
    """Choose the protection of side information and importance tiers for a byte budget, for `serve --plan`.

    A tier is a group of elements of similar importance. The plan gives the amount of redundancy for each tier and for
    the side information (data that all packets need), chosen for the best picture after the losses of the channel. The
    expected PSNR assumes that the complete scene has 30 dB. For clips without --reference, it assumes that the finest
    stream has 45 dB.
    """

    streams: tyro.conf.Positional[list[str]]
    """Complete stream, preferably encoded with --tiers; - for standard input. Several streams of one scene are
    compared, e.g. with tiers, without tiers, with a sketch. A stream of another preset than datagram is planned in the
    packets that `serve` would send."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Plan to write: a JSON file for `serve --plan`."""
    loss: str = "bernoulli:0.2"
    """Channel, in datagrams: bernoulli:RATE, gilbert:RATE,BURST, ..."""
    budget: float | None = None
    """Number of bytes that may be sent, relative to the stream without protection; default 1.3."""
    deadline: float | None = None
    """Instead of --budget: time after which packets are useless, seconds; needs --rate. Clips: for each group of
    frames."""
    rate: float | None = None
    """With --deadline: rate of the link in megabits per second."""
    most_protection: float = 1.0
    """Maximum share of protection in all bytes; 0.08 is 8 %."""
    feedback: bool = False
    """Plan for a receiver that requests retransmission: no parity is sent, and the plan lists the packets to
    retransmit."""
    conceal: str | None = None
    """Concealer of the receiver. Default: grow; motion for clips. For a stream with a sketch it is always sketch."""
    data: Path | None = None
    """Folder with photos and poses; quality is measured in its training cameras. Default: cameras around the scene."""
    reference: Path | None = None
    """Clips: folder of the source frames. Default: the stream with the finest quality."""
    views: int | None = None
    """Number of views in which the distortion is measured, default 7 (clips: 3). Few views miss parts of the scene."""
    trials: int | None = None
    """Simulated transfers per candidate (clips: per group of frames), default 100; not with --feedback."""
    drawn: int = 6
    """Number of simulated transfers that are rendered to choose between the best candidates."""
    seed: int = 0
    """Seed of the simulated losses."""
    json: JsonFlag = False
    """Print one JSON object."""
