"""Options of `splatwire plan`."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._files import check_inputs, prepared_output
from splatwire.cli._output import JsonFlag
from splatwire.errors import InvalidValueError

_BUDGET, _TRIALS, _VIEWS = 1.3, 100, 7


@dataclass(frozen=True)
class PlanOptions:
    """What is planned for, and how carefully."""

    streams: tyro.conf.Positional[list[str]]
    """Complete stream, best encoded with --tiers; - for standard input. Several streams of one scene compete: without
    tiers, with tiers, with a sketch. One of another preset than datagram is planned for as `serve` sends it."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Plan to write, a JSON object that `serve --plan` takes."""
    loss: str = "bernoulli:0.2"
    """Channel, in datagrams: bernoulli:RATE, gilbert:RATE,BURST, ..."""
    budget: float | None = None
    """Bytes that may be sent, as a multiple of the stream without any protection; 1.3 where absent."""
    deadline: float | None = None
    """Instead of --budget: seconds until nothing more counts; needs --rate. Of a clip: for each group of frames."""
    rate: float | None = None
    """With --deadline: megabits per second."""
    most_protection: float = 1.0
    """Most protection as a share of all bytes: 0.08 for 8 %."""
    way_back: bool = False
    """The receiver can ask for what it lacks: nothing is sent ahead, and the plan says which packets are sent again."""
    conceal: str | None = None
    """What the receiver does about gaps; grow where absent, motion for a clip. A stream that carries a sketch is
    concealed by it."""
    data: Path | None = None
    """Photos whose training cameras say what is seen; cameras around the scene if not given."""
    reference: Path | None = None
    """Of a clip: folder of the frames that it was made of. Without it the finest stream stands for them."""
    views: int | None = None
    """Views that the damage is measured in, 7 where absent, 3 for a clip; few tell too little of what is seen from
    elsewhere."""
    trials: int | None = None
    """Simulated transfers of each candidate, 100 where absent (a clip: of each group of frames); there are none with
    --way-back."""
    drawn: int = 6
    """Simulated transfers whose pictures decide between the best candidates."""
    seed: int = 0
    """Of the simulated losses."""
    json: JsonFlag = False
    """Print one JSON object."""

    def check(self) -> None:
        """Refuses what contradicts itself, before any work.

        Raises:
            InvalidValueError: If something does.
        """
        if not self.streams:
            raise InvalidValueError("name at least one stream to plan for")
        if self.output is not None:
            prepared_output(self.output)
        check_inputs(self.data, self.reference)
        if (self.deadline is None) != (self.rate is None) or (self.deadline is not None and self.budget is not None):
            raise InvalidValueError("give --budget, or --deadline and --rate together")
        above = {"--budget": self.budget, "--deadline": self.deadline, "--rate": self.rate}
        for name, value in above.items():
            if value is not None and not 0 < value < math.inf:
                raise InvalidValueError(f"{name} must be above 0, not {value:g}")
        if min(self.num_views, self.drawn, self.num_trials) < 1:
            raise InvalidValueError("--views, --trials and --drawn are at least 1")
        if not 0 < self.most_protection <= 1:
            raise InvalidValueError(f"--most-protection is above 0 and at most 1, not {self.most_protection:g}")
        if self.way_back and self.trials is not None:
            raise InvalidValueError("--trials: with --way-back nothing is simulated that it counts")
        if self.seed < 0:
            raise InvalidValueError(f"--seed is 0 or more, not {self.seed}")

    @property
    def num_trials(self) -> int:
        """Simulated transfers of each candidate."""
        return _TRIALS if self.trials is None else self.trials

    @property
    def num_views(self) -> int:
        """Views of a still scene that the damage is measured in."""
        return _VIEWS if self.views is None else self.views

    def budget_bytes(self, plain: int) -> float:
        """Bytes that may be sent.

        Args:
            plain: Those of the stream without protection.
        """
        if self.deadline is None or self.rate is None:
            return (_BUDGET if self.budget is None else self.budget) * plain
        return self.deadline * self.rate * 1e6 / 8
