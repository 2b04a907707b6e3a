"""Models of packet loss: which of n packets, sent one after another, arrive."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError, UnknownNameError

UNIT = "pak"
"""What these models lose: whole `.pak` packets. One of them may fill several datagrams, so a rate per datagram is a
different (much lower) rate."""

MAX_TRACE_BYTES = 1 << 26


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
        """What is lost as one, such as `pak`."""

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws the fate of n packets in the order in which they are sent.

        Args:
            n: Number of packets.
            rng: Source of all randomness.

        Returns:
            True where the packet arrives, bool, n.
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


LOSS_PRESETS = {
    "webrtc-20/3": GilbertElliott(0.20, 3),
    "20/20": GilbertElliott(0.20, 20),
    "10/8": GilbertElliott(0.10, 8),
    "5/5": GilbertElliott(0.05, 5),
    "2/10": GilbertElliott(0.02, 10),
    "1/20": GilbertElliott(0.01, 20),
}
"""Named bursts: percent lost / mean burst in packets. `webrtc-20/3` is a setting of libwebrtc's own tests."""


@dataclass(frozen=True)
class Trace:
    """Replays a recorded trace from its beginning; draws nothing at random.

    The file is text: one entry per packet, `1` or `received`, `0` or `lost` (either case), with white space, commas or
    nothing between the digits; `#` starts a comment. **1 means that the packet arrived.**

    Attributes:
        path: The file.
        repeat: Whether to start over when more packets are sent than the trace has; otherwise that is an error.
        entries: The trace, True where a packet arrived, bool.

    Raises:
        DatasetError: If the file is missing or not a trace; the message names the line.
    """

    path: Path | str
    repeat: bool = False
    unit: str = field(default=UNIT, kw_only=True)
    entries: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "entries", read_trace(Path(self.path)))

    @property
    def name(self) -> str:
        """`trace:FILE[,repeat]`."""
        return f"trace:{self.path}{',repeat' if self.repeat else ''}"

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """See `LossModel.received`.

        Raises:
            DatasetError: If the trace is too short and is not to be repeated.
        """
        if n > len(self.entries) and not self.repeat:
            raise DatasetError(
                f"{self.path} has {len(self.entries)} entries and {n} packets are sent; add ',repeat' to start it over"
            )
        return np.resize(self.entries, n)


_WORDS = {"received": True, "lost": False}


def read_trace(path: Path) -> np.ndarray:
    """Reads the file of a `Trace`.

    Returns:
        True where a packet arrived, bool.

    Raises:
        DatasetError: If the file is missing, too large, empty or not a trace.
    """
    try:
        if not path.is_file():
            raise DatasetError(f"loss trace {path} is not a file")
        with path.open("rb") as file:
            data = file.read(MAX_TRACE_BYTES + 1)
    except OSError as error:
        raise DatasetError(f"loss trace {path} cannot be read: {error}") from error
    if len(data) > MAX_TRACE_BYTES:
        raise DatasetError(f"loss trace {path} is larger than {MAX_TRACE_BYTES} bytes")
    entries = bytearray()
    for number, line in enumerate(data.split(b"\n"), 1):
        for word in line.partition(b"#")[0].replace(b",", b" ").lower().split():
            known = _WORDS.get(word.decode("ascii", "replace"))
            if known is not None:
                entries.append(known)
            elif word.strip(b"01"):
                raise DatasetError(f"loss trace {path}, line {number}: {word[:20]!r} is not 0, 1, lost or received")
            else:
                entries += word.translate(_DIGITS)
    if not entries:
        raise DatasetError(f"loss trace {path} has no entries")
    return np.frombuffer(bytes(entries), np.uint8).astype(bool)


_DIGITS = bytes.maketrans(b"01", b"\x00\x01")


def parse_loss(spec: str) -> LossModel:
    """Makes a loss model from text.

    Args:
        spec: `none`, `bernoulli:RATE`, `gilbert:RATE,BURST`, `gilbert:RATE,BURST,ARRIVAL_BAD,ARRIVAL_GOOD`,
            `gilbert:PRESET` (a key of `LOSS_PRESETS`) or `trace:FILE[,repeat]`. Rates are shares from 0 to 1.

    Raises:
        UnknownNameError: If there is no such model or preset.
        InvalidValueError: If a parameter is missing, superfluous or out of range.
        DatasetError: If a trace file is missing or not a trace.
    """
    kind, colon, text = spec.strip().partition(":")
    if kind == "none" and not colon:
        return Nothing()
    if kind == "bernoulli":
        return Bernoulli(*_numbers(spec, text, (1,), "bernoulli:RATE"))
    if kind == "gilbert":
        if text in LOSS_PRESETS:
            return LOSS_PRESETS[text]
        if text and "," not in text:
            raise UnknownNameError("gilbert preset", text, [*LOSS_PRESETS, "RATE,BURST"])
        return GilbertElliott(*_numbers(spec, text, (2, 4), "gilbert:RATE,BURST"))
    if kind == "trace":
        if not text:
            raise InvalidValueError(f"'{spec}' names no file: it should look like trace:FILE")
        return Trace(Path(text.removesuffix(",repeat")), repeat=text.endswith(",repeat"))
    raise UnknownNameError("loss model", spec, ("none", "bernoulli:RATE", "gilbert:RATE,BURST", "trace:FILE"))


def _numbers(spec: str, text: str, counts: tuple[int, ...], form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidValueError(f"'{spec}' should look like {form}")
    return numbers
