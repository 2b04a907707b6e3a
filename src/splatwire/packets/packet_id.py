"""What a packet is called."""

import re
from dataclasses import dataclass

from splatwire.errors import InvalidValueError
from splatwire.packets.limits import MAX_FEATURE_GROUPS

PARTS = ("anchor", "scaling", "offset", *(f"feature{group}" for group in range(MAX_FEATURE_GROUPS)))
"""What a packet carries of its anchors, by `PacketId.part`; `anchor` is everything. The others are the files of HAC++:
with separated packaging, each is a packet of its own, and a feature group can be read after all groups before it."""
SCALING, OFFSET, FIRST_FEATURE = 1, 2, 3


@dataclass(frozen=True, order=True, slots=True)
class PacketId:
    """Name of a packet within its stream; sorts by block, then lane, then part.

    Attributes:
        block: Spatial block, t.
        lane: Lane within the block, λ; with hashed grouping, position of its first element in the block's hash order.
        part: What it carries of its elements, an index into `PARTS`.
    """

    block: int
    lane: int
    part: int = 0

    @property
    def filename(self) -> str:
        """File name of the packet in a stream directory: `pak_lane{lane}_s{block}.pak` for whole anchors."""
        suffix = f"_{PARTS[self.part]}" if self.part else ""
        return f"pak_lane{self.lane}_s{self.block}{suffix}.pak"

    @classmethod
    def from_filename(cls, name: str) -> "PacketId":
        """Reads a file name back.

        Raises:
            InvalidValueError: If it is not exactly a name that `filename` gives.
        """
        match = _FILENAME.fullmatch(name)
        if match is None or (match["part"] or PARTS[0]) not in PARTS:
            raise InvalidValueError(f"'{name}' is not a packet name such as pak_lane3_s0.pak")
        return cls(int(match["block"]), int(match["lane"]), PARTS.index(match["part"] or PARTS[0]))


_FILENAME = re.compile(
    r"pak_lane(?P<lane>0|[1-9][0-9]{0,4})_s(?P<block>0|[1-9][0-9]{0,7})(?:_(?P<part>scaling|offset|feature(?:0|[1-9][0-9]?)))?\.pak",
    re.ASCII,
)
