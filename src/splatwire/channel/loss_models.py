"""Packet loss models, which draw at random which packets are received."""

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from splatwire.arguments import CheckedFields, check_fields, checked
from splatwire.errors import InvalidValueError

UNIT = "pak"
UNITS = (UNIT, "datagram")
"""Units of loss: `pak` loses whole packets of the stream, `datagram` loses UDP datagrams. A packet may fill several
datagrams and is lost with any of them. The same share of lost packets thus needs a much lower loss rate per datagram.
"""
UNIT_NAMES = {"pak": "packet", "datagram": "datagram"}
"""Names of the units of loss in reports."""


def _check_share(name: str, value: float | int) -> None:
    if not 0 <= value <= 1:  # also rejects NaN
        raise InvalidValueError(f"{name} must be a share from 0 to 1, not {value:g}")


def _format_number(number: float | int) -> str:
    """Formats a number as the shortest text that parses to the same number."""
    return repr(float(number)).removesuffix(".0")


@runtime_checkable
class LossModel(Protocol):
    """Loss model of a channel: draws which packets (or datagrams) are received."""

    @property
    def name(self) -> str:
        """Name and parameters of the model as text that `parse_loss` parses, such as `bernoulli:0.2`."""

    @property
    def unit(self) -> str:
        """Unit of loss: `pak` (packet of the stream) or `datagram`."""

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws which of n packets (or datagrams) are received.

        Args:
            n: Number of packets or datagrams sent.
            rng: Random generator, the only source of randomness.

        Returns:
            True for each received packet or datagram, in sending order, bool, shape (n,).
        """


def draw_checked(model: LossModel, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draws which of n packets (or datagrams) are received, and checks the mask that the loss model returns.

    Args:
        model: The loss model.
        n: Number of packets or datagrams sent.
        rng: Random generator.

    Returns:
        True for each received packet or datagram, in sending order, bool, shape (n,).

    Raises:
        InvalidValueError: If the model does not return n booleans.
    """
    mask = np.asarray(model.received(n, rng))
    if mask.shape != (n,) or mask.dtype != np.bool_:
        result = f"{mask.dtype} of shape {mask.shape}, not {n} booleans"
        raise InvalidValueError(f"loss model '{model.name}' returned {result}")
    return mask


@dataclass(frozen=True)
class NoLoss(CheckedFields):
    """Loss model of a channel without loss."""

    unit: str = field(default=UNIT, kw_only=True)

    @property
    def name(self) -> str:
        """Name of the model, `none`, in the syntax of `parse_loss`."""
        return "none"

    @checked
    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Returns a mask of received packets in which all n entries are True, bool, shape (n,)."""
        return np.ones(n, bool)


@dataclass(frozen=True)
class Bernoulli:
    """Loss model that loses each packet (or datagram) independently with the same probability.

    Attributes:
        rate: Probability that a packet is lost, 0 to 1.

    Raises:
        InvalidValueError: If the rate is not between 0 and 1.
    """

    rate: float | int
    unit: str = field(default=UNIT, kw_only=True)

    def __post_init__(self) -> None:
        check_fields(self)
        _check_share("loss rate", self.rate)

    @property
    def name(self) -> str:
        """Name and loss rate of the model, `bernoulli:RATE`, in the syntax of `parse_loss`."""
        return f"bernoulli:{_format_number(self.rate)}"

    @checked
    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws which of n packets (or datagrams) are received; returns the mask, bool, (n,)."""
        return rng.random(n) >= self.rate


@dataclass(frozen=True)
class GilbertElliott:
    """Loss model with bursts of losses: a Markov chain of a good and a bad state.

    The defaults are the Gilbert model: all packets arrive in the good state, none in the bad one. Source: G. Haßlinger,
    O. Hohlfeld, "The Gilbert-Elliott model for packet loss in real time services on the Internet", 2008.

    Attributes:
        rate: Fraction of packets lost in the long run, 0 to 1.
        mean_burst: Mean duration of the bad state, packets, at least 1.
        arrival_bad: Probability that a packet sent in the bad state is received, 0 to 1 (h in the source).
        arrival_good: Probability that a packet sent in the good state is received, 0 to 1 (k in the source).

    Raises:
        InvalidValueError: If no Markov chain has this loss rate and mean burst.
    """

    rate: float | int
    mean_burst: float | int
    arrival_bad: float | int = 0.0
    arrival_good: float | int = 1.0
    unit: str = field(default=UNIT, kw_only=True)

    def __post_init__(self) -> None:
        check_fields(self)
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
        """Model with its parameters, `gilbert:RATE,BURST[,ARRIVAL_BAD,ARRIVAL_GOOD]`, in the syntax of `parse_loss`."""
        plain = (self.arrival_bad, self.arrival_good) == (0.0, 1.0)
        numbers = (self.rate, self.mean_burst) + (() if plain else (self.arrival_bad, self.arrival_good))
        return f"gilbert:{','.join(map(_format_number, numbers))}"

    @property
    def r(self) -> float:
        """Probability per packet of a transition from the bad to the good state."""
        return 1 / self.mean_burst

    @property
    def p(self) -> float:
        """Probability per packet of a transition from the good to the bad state."""
        return self.r * self.share_bad / (1 - self.share_bad) if self.share_bad < 1 else 1.0

    @property
    def share_bad(self) -> float:
        """Long-run share of time in the bad state, 0 to 1."""
        share = (self.rate - (1 - self.arrival_good)) / (self.arrival_good - self.arrival_bad)
        return min(max(share, 0.0), 1.0)  # rounding errors may exceed the range

    @checked
    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws which of n packets (or datagrams) are received; returns the mask, bool, (n,)."""
        # A chain that is always bad has no transition to good, whatever the burst length.
        bad = self._states(n, rng) if self.share_bad < 1 else np.ones(n, bool)
        return rng.random(n) < np.where(bad, self.arrival_bad, self.arrival_good)

    def _states(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Simulates the Markov chain for n packets: True for each packet sent in the bad state, bool, shape (n,)."""
        draws = rng.random(n)
        leave, enter = draws < self.r, draws < self.p
        start = bool(rng.random() < self.share_bad)
        # A draw that only leaves ends in the good state, one that only enters in the bad state, from either start. A
        # draw that does both swaps the state; one that does neither keeps it. Each state thus follows from the last
        # definite one and the number of swaps since.
        swaps = np.concatenate([[0], np.cumsum(leave & enter)])
        ends = np.where(leave ^ enter, np.arange(1, n + 1), 0)
        last = np.concatenate([[0], np.maximum.accumulate(ends)])[:n]
        states = np.concatenate([[start], enter])[last]
        return states ^ ((swaps[:n] - swaps[last]) % 2 == 1)
