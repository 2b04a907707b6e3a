"""Packet ids and the file names of packets."""

import re
from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.bitstream.limits import MAX_FEATURE_GROUPS
from splatwire.errors import InvalidValueError

PARTS = ("anchor", "scaling", "offset", *(f"feature{group}" for group in range(MAX_FEATURE_GROUPS)))
"""Names of the contents of packets, indexed by `PacketId.part`.

A packet `anchor` contains whole elements (all attributes). With separated packaging, as in HAC++, a packet contains a
single attribute of its elements instead; decoding a group of feature channels requires the packets of all groups before
it.
"""
SCALING, OFFSET, FIRST_FEATURE = 1, 2, 3


@dataclass(frozen=True, order=True, slots=True)
class PacketId:
    """Id of a packet within a stream.

    Ids are ordered by the three attributes: by block, then by index in the block, then by part.

    Attributes:
        block: Index of the spatial block, a group of neighbouring elements (anchors or Gaussians).
        index_in_block: Index of the packet among the packets of its block. If packets are filled up to a size limit
            (grouping `hashed`), it is instead the index of the packet's first element in the block: the number of
            elements in earlier packets of the block.
        part: Attribute of the elements that the packet contains, an index into `PARTS`; 0 for all attributes.
    """

    block: int
    index_in_block: int
    part: int = 0

    def __post_init__(self) -> None:
        # This check runs once per packet, so it must be fast.
        if type(self.block) is not int or type(self.index_in_block) is not int or type(self.part) is not int:
            check_fields(self)

    @property
    def filename(self) -> str:
        """File name in a stream directory, such as `pak_lane{index_in_block}_s{block}.pak` for atomic packets."""
        suffix = f"_{PARTS[self.part]}" if self.part else ""
        return f"pak_lane{self.index_in_block}_s{self.block}{suffix}.pak"

    @classmethod
    def from_filename(cls, name: str) -> "PacketId":
        """Parses the file name of a packet in a stream directory (`filename`).

        Raises:
            InvalidValueError: If the text is not the file name of a packet.
        """
        match = _FILENAME.fullmatch(name)
        if match is None or (match["part"] or PARTS[0]) not in PARTS:
            raise InvalidValueError(f"'{name}' is not a packet name such as pak_lane3_s0.pak")
        return cls(int(match["block"]), int(match["index"]), PARTS.index(match["part"] or PARTS[0]))


_FILENAME = re.compile(
    r"pak_lane(?P<index>0|[1-9][0-9]{0,4})_s(?P<block>0|[1-9][0-9]{0,7})(?:_(?P<part>scaling|offset|feature(?:0|[1-9][0-9]?)))?\.pak",
    re.ASCII,
)
