"""Models of packet loss: which of n packets, sent one after another, arrive."""

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from splatwire.errors import InvalidValueError

UNIT = "pak"
UNITS = (UNIT, "datagram")
"""What models lose as one: whole `.pak` packets, or datagrams. A packet may fill several datagrams, so a rate per
datagram is a different (much lower) rate."""


def _check_share(what: str, value: float | int) -> None:
    if not 0 <= value <= 1:  # also refuses NaN
        raise InvalidValueError(f"{what} must be a share from 0 to 1, not {value:g}")


def _text(number: float | int) -> str:
    """Shortest text that reads back as the same number: 0.2, 3."""
    return repr(float(number)).removesuffix(".0")


@runtime_checkable
class LossModel(Protocol):
    """Decides which packets arrive."""

    @property
    def name(self) -> str:
        """The model and its parameters as text; `parse_loss` reads it back."""

    @property
    def unit(self) -> str:
        """What is lost as one, one of `UNITS`."""

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws the fate of n units in the order in which they are sent.

        Args:
            n: Number of units: packets, or datagrams.
            rng: Source of all randomness.

        Returns:
            True where the unit arrives, bool, n.
        """


@dataclass(frozen=True)
class Nothing:
    """Loses nothing."""

    unit: str = field(default=UNIT, kw_only=True)

    @property
    def name(self) -> str:
        """`none`."""
        return "none"

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Everything arrives; see `LossModel.received`."""
        return np.ones(n, bool)


@dataclass(frozen=True)
class Bernoulli:
    """Loses each packet independently.

    Attributes:
        rate: Probability that a packet is lost, 0 to 1 (both included).

    Raises:
        InvalidValueError: If the rate is outside of that.
    """

    rate: float | int
    unit: str = field(default=UNIT, kw_only=True)

    def __post_init__(self) -> None:
        _check_share("loss rate", self.rate)

    @property
    def name(self) -> str:
        """`bernoulli:RATE`."""
        return f"bernoulli:{_text(self.rate)}"

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """See `LossModel.received`."""
        return rng.random(n) >= self.rate


@dataclass(frozen=True)
class GilbertElliott:
    """Loses packets in bursts: a chain of a good and a bad state, started in its stationary distribution.

    `r = 1 / mean_burst` is the chance per packet to leave the bad state and `p = r * b / (1 - b)` the chance to enter
    it, where `b` is the share of time spent in the bad state. With the defaults (nothing arrives in the bad state,
    everything in the good one: the plain Gilbert model) `b` is the loss rate. Source: G. Haßlinger, O. Hohlfeld, "The
    Gilbert-Elliott model for packet loss in real time services on the Internet", 2008.

    Attributes:
        rate: Share of packets lost in the long run, 0 to 1 (both included).
        mean_burst: Mean stay in the bad state, packets, at least 1.
        arrival_bad: Chance that a packet arrives in the bad state, h.
        arrival_good: Chance that a packet arrives in the good state, k.

    Raises:
        InvalidValueError: If no such chain exists.
    """

    rate: float | int
    mean_burst: float | int
    arrival_bad: float | int = 0.0
    arrival_good: float | int = 1.0
    unit: str = field(default=UNIT, kw_only=True)

    def __post_init__(self) -> None:
        _check_share("loss rate", self.rate)
        _check_share("arrival in the bad state", self.arrival_bad)
        _check_share("arrival in the good state", self.arrival_good)
        if not (math.isfinite(self.mean_burst) and self.mean_burst >= 1):
            raise InvalidValueError(f"mean burst must be at least 1 packet, not {self.mean_burst:g}")
        low, high = 1 - self.arrival_good, 1 - self.arrival_bad
        if not (low < high and low <= self.rate <= high):
            raise InvalidValueError(
                f"a loss rate of {self.rate:g} cannot come from states that lose {low:g} and {high:g}"
            )
        if self.share_bad < 1 and self.p > 1:
            least = self.share_bad / (1 - self.share_bad)
            raise InvalidValueError(
                f"a loss rate of {self.rate:g} needs a mean burst of at least {least:g}, not {self.mean_burst:g}"
            )

    @property
    def name(self) -> str:
        """`gilbert:RATE,BURST[,ARRIVAL_BAD,ARRIVAL_GOOD]`."""
        plain = (self.arrival_bad, self.arrival_good) == (0.0, 1.0)
        numbers = (self.rate, self.mean_burst) + (() if plain else (self.arrival_bad, self.arrival_good))
        return f"gilbert:{','.join(map(_text, numbers))}"

    @property
    def r(self) -> float:
        """Chance per packet to go from the bad state to the good one."""
        return 1 / self.mean_burst

    @property
    def p(self) -> float:
        """Chance per packet to go from the good state to the bad one."""
        return self.r * self.share_bad / (1 - self.share_bad) if self.share_bad < 1 else 1.0

    @property
    def share_bad(self) -> float:
        """Share of time spent in the bad state."""
        share = (self.rate - (1 - self.arrival_good)) / (self.arrival_good - self.arrival_bad)
        return min(max(share, 0.0), 1.0)  # rounding may step over the ends

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """See `LossModel.received`."""
        # A chain that is always bad has no way back, whatever the burst length says.
        bad = self._states(n, rng) if self.share_bad < 1 else np.ones(n, bool)
        return rng.random(n) < np.where(bad, self.arrival_bad, self.arrival_good)

    def _states(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Walks the chain; True in the bad state, bool, n."""
        draws = rng.random(n)
        leave, enter = draws < self.r, draws < self.p
        start = bool(rng.random() < self.share_bad)
        # A step that only leaves ends in the good state and one that only enters in the bad one, wherever it began; one
        # that does both swaps, one that does neither keeps: all states follow from the last end and the swaps since.
        swaps = np.concatenate([[0], np.cumsum(leave & enter)])
        ends = np.where(leave ^ enter, np.arange(1, n + 1), 0)
        last = np.concatenate([[0], np.maximum.accumulate(ends)])[:n]
        there = np.concatenate([[start], enter])[last]
        return there ^ ((swaps[:n] - swaps[last]) % 2 == 1)
