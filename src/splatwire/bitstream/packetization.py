"""Parameters of the division of elements into packets."""

from dataclasses import dataclass

from splatwire.arguments import check_fields, checked
from splatwire.bitstream.limits import (
    CODING_ORDERS,
    GROUPINGS,
    MAX_BLOCK_SIZE,
    MAX_HASHED_BLOCK,
    MAX_HASHED_PACKET_BYTES,
    MAX_LANES,
    MIN_PACKET_BYTES,
    PACKAGINGS,
    SCHEMAS,
)
from splatwire.errors import InvalidValueError, UnknownNameError, shown

DATAGRAM_BYTES = 1200
"""Size of a datagram that passes every network path, bytes (RFC 9000, 14)."""
DATAGRAM_PACKET_BYTES = 1150
"""Largest packet with the `datagram` preset, bytes; up to 50 bytes of a datagram are left for transport headers."""


def check_range(name: str, value: int, low: int, high: int) -> None:
    """Checks that a value is an integer within a range.

    Args:
        name: Name of the value, for the error message.
        value: The value.
        low: Smallest permitted value.
        high: Largest permitted value.

    Raises:
        InvalidValueError: If the value is not an integer or out of range.
    """
    if type(value) is not int or not low <= value <= high:
        raise InvalidValueError(f"{name} must be an integer from {low} to {high}, not {shown(value)}")


@dataclass(frozen=True)
class Packetization:
    """Parameters of the division of elements (Gaussians or anchors) into packets.

    The defaults follow Sections 3.2.2 and 4.1 of the paper that this project implements (docs/paper-map.md).

    Attributes:
        block_size: Maximum number of elements of a spatial block.
        lanes: Number of packets of each block. With the grouping `hashed`, the value is 1 and has no meaning.
        seed: Seed of the hash that divides plan indices (see `PacketPlan`) among packets, 64 bits.
        order: Coding order of the anchors: `morton` (Z-order) or `raster` (z, then y, then x, as in HAC++).
        grouping: Division of a block's plan indices among packets: `stratified` (by hash), `contiguous` (consecutive
            indices) or `hashed` (in the order of a hash, each packet filled up to `packet_bytes`; `lanes` is 1). For
            anchors, this determines the members of a packet. The encoder of explicit Gaussians chooses the members of
            each packet; the hash fixes only their indices in the decoded scene and, with `stratified`, their number.
        packaging: `atomic` (a packet contains whole anchors) or `separated` (separate packets for each feature group,
            for scalings and for offsets, as in HAC++).
        packet_bytes: Maximum packet size with grouping `hashed`, header included; 0 with any other grouping.

    Raises:
        UnknownNameError: If order, grouping or packaging is not one of the above.
        InvalidValueError: If a number is out of range.
    """

    block_size: int = 3000
    lanes: int = 8
    seed: int = 1337
    order: str = "morton"
    grouping: str = "stratified"
    packaging: str = "atomic"
    packet_bytes: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_range("block size", self.block_size, 1, MAX_BLOCK_SIZE)
        check_range("number of lanes", self.lanes, 1, MAX_LANES)
        check_range("packetization seed", self.seed, 0, (1 << 64) - 1)
        for kind, name, allowed in (
            ("order", self.order, CODING_ORDERS),
            ("grouping", self.grouping, GROUPINGS),
            ("packaging", self.packaging, PACKAGINGS),
        ):
            if name not in allowed:
                raise UnknownNameError(kind, str(name), allowed)
        self._check_hashed()

    def _check_hashed(self) -> None:
        if not self.hashed:
            check_range(f"packet size with {self.grouping} grouping", self.packet_bytes, 0, 0)
            return
        check_range("packet size with hashed grouping", self.packet_bytes, MIN_PACKET_BYTES, MAX_HASHED_PACKET_BYTES)
        check_range("block size with hashed grouping", self.block_size, 1, MAX_HASHED_BLOCK)
        check_range("number of lanes with hashed grouping", self.lanes, 1, 1)
        if self.packaging != "atomic":
            raise InvalidValueError("hashed grouping knows atomic packaging only")

    @property
    def hashed(self) -> bool:
        """True if packets are filled up to a size limit, with plan indices in hash order (grouping `hashed`)."""
        return self.grouping == "hashed"

    @property
    def loss_unit(self) -> str:
        """Unit of simulated losses: `datagram` if no packet can exceed one datagram, else `pak` (whole packets)."""
        return "datagram" if self.hashed and self.packet_bytes <= DATAGRAM_BYTES else "pak"

    @property
    def separated(self) -> bool:
        """True if each attribute of an element is in a separate packet."""
        return self.packaging == "separated"

    @property
    def universal(self) -> bool:
        """True if every codec supports this packetization: atomic packets in Morton order."""
        return not self.separated and self.order == "morton"


PRESETS = {
    "paper": Packetization(),
    "hacpp": Packetization(lanes=1, order="raster", grouping="contiguous", packaging="separated"),
    "datagram": Packetization(lanes=1, grouping="hashed", packet_bytes=DATAGRAM_PACKET_BYTES),
}
"""Named packetizations: the paper's; HAC++'s layout (the baseline: batches of 3000 anchors in raster order); and
packets that fit a datagram.
"""

SPREAD = "spread"
"""Name of the packetization with lanes over blocks as large as possible (`spread_packetization`), accepted by
`packetization_named` in addition to `PRESETS`."""
_PACKET_ELEMENTS, _MIN_LANES = 375, 8
"""Elements per packet and minimum number of lanes, as in the paper."""


@checked
def spread_packetization(num_elements: int) -> Packetization:
    """Returns a packetization whose packets each contain elements from all over the scene.

    A lost packet then thins the scene out evenly instead of leaving a hole. More than 65,535 elements are divided into
    blocks, as few as possible, and each packet contains elements from all over its block.

    Args:
        num_elements: Number of elements to encode.
    """
    # At equal bytes and 20 % loss, up to 0.44 dB more than blocks of 3000 elements (`benchmarks/results/spread.json`).
    blocks = max(1, -(-num_elements // MAX_BLOCK_SIZE))
    size = max(1, -(-num_elements // blocks))
    return Packetization(block_size=size, lanes=max(_MIN_LANES, -(-size // _PACKET_ELEMENTS)))


@checked
def packetization_named(name: str | None, schema: str, num_elements: int) -> Packetization:
    """Returns the packetization with a given name, adapted to a scene.

    Args:
        name: `SPREAD` or a key of `PRESETS`; None selects the default of the schema.
        schema: Codec schema, a name in `SCHEMAS`.
        num_elements: Number of elements to encode.

    Raises:
        UnknownNameError: If the name is unknown.
    """
    name = name or (SPREAD if SCHEMAS[schema].large_blocks else "paper")
    if name == SPREAD:
        return spread_packetization(num_elements)
    if name not in PRESETS:
        raise UnknownNameError("preset", name, (SPREAD, *PRESETS))
    return PRESETS[name]
