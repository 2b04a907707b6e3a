"""Loss model that replays a recorded loss trace from a file."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from splatwire.arguments import check_fields, checked
from splatwire.channel.loss_models import UNIT
from splatwire.errors import DatasetError

MAX_TRACE_BYTES = 1 << 26


@dataclass(frozen=True)
class Trace:
    """Loss model that replays a recorded loss trace.

    The file is text with one entry per packet: `1` or `received`, `0` or `lost`. Entries are separated by white space
    or commas; digits may also follow each other directly. `#` starts a comment.

    Attributes:
        path: Path of the trace file.
        repeat: True to start again when more packets are sent than the trace has entries; False to raise an error.
        entries: True for each received packet of the trace, bool, shape (number of entries,).

    Raises:
        DatasetError: If the file is missing or not a trace; the message has the line number.
    """

    path: Path | str
    repeat: bool = False
    unit: str = field(default=UNIT, kw_only=True)
    entries: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "entries", read_trace(Path(self.path)))

    @property
    def name(self) -> str:
        """Model with the path of its file, `trace:FILE[,repeat]`, in the syntax of `parse_loss`."""
        return f"trace:{self.path}{',repeat' if self.repeat else ''}"

    @checked
    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Returns the first n entries of the trace.

        Args:
            n: Number of packets or datagrams sent.
            rng: Not used.

        Returns:
            True for each received packet or datagram, in sending order, bool, shape (n,).

        Raises:
            DatasetError: If the trace has fewer than n entries and `repeat` is False.
        """
        if n > len(self.entries) and not self.repeat:
            raise DatasetError(
                f"{self.path} has {len(self.entries)} entries and {n} packets are sent; add ',repeat' to start it over"
            )
        return np.resize(self.entries, n)


_WORDS = {"received": True, "lost": False}


def read_trace(path: Path) -> np.ndarray:
    """Reads a recorded loss trace from a text file.

    Args:
        path: Path of the trace file.

    Returns:
        True for each received packet, bool, shape (number of entries,).

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
            is_received = _WORDS.get(word.decode("ascii", "replace"))
            if is_received is not None:
                entries.append(is_received)
            elif word.strip(b"01"):
                raise DatasetError(f"loss trace {path}, line {number}: {word[:20]!r} is not 0, 1, lost or received")
            else:
                entries += word.translate(_DIGITS)
    if not entries:
        raise DatasetError(f"loss trace {path} has no entries")
    return np.frombuffer(bytes(entries), np.uint8).astype(bool)


_DIGITS = bytes.maketrans(b"01", b"\x00\x01")
