"""Losses as they were recorded."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from splatwire.channel.loss_models import UNIT
from splatwire.errors import DatasetError

MAX_TRACE_BYTES = 1 << 26


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
