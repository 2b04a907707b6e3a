"""Parameters of the packetization: how elements are split into packets."""

from dataclasses import dataclass

from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.packets.limits import (
    GROUPINGS,
    MAX_BLOCK_SIZE,
    MAX_DATAGRAM_BYTES,
    MAX_HASHED_BLOCK,
    MAX_LANES,
    MIN_PACKET_BYTES,
    ORDERS,
    PACKAGINGS,
    SCHEMAS,
)

DATAGRAM_BYTES = 1150
"""A datagram of 1200 bytes passes every path (RFC 9000, 14); up to 50 of them are for the layers around a packet."""


def check_range(what: str, value: int, low: int, high: int) -> None:
    """Insists on an integer within bounds.

    Raises:
        InvalidValueError: If it is something else.
    """
    if type(value) is not int or not low <= value <= high:
        raise InvalidValueError(f"{what} must be an integer from {low} to {high}, not {value!r}")


@dataclass(frozen=True)
class Packetization:
    """How elements are split into packets (paper 3.2.2 and 4.1, "Packetization Parameters").

    Attributes:
        block_size: Most elements of a spatial block.
        lanes: Packets that a block is split into.
        seed: Seed of the lane hash, 64 bits.
        order: How anchors are ranked: `morton` (true Z-order) or `raster` (z-major, what HAC++ does).
        grouping: `stratified` (hashed lanes), `contiguous` (each lane a run of consecutive ranks) or `hashed` (the
            block's elements in the order of their hashes, as many to a packet as its bytes allow; `lanes` is 1).
        packaging: `atomic` (a packet holds whole anchors) or `separated` (a packet for each feature group, one for the
            scalings, one for the offsets, as in HAC++; the baseline of the ablation).
        packet_bytes: With hashed grouping the most bytes of a packet, header included; 0 with every other.

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
        check_range("block size", self.block_size, 1, MAX_BLOCK_SIZE)
        check_range("number of lanes", self.lanes, 1, MAX_LANES)
        check_range("packetization seed", self.seed, 0, (1 << 64) - 1)
        for kind, name, known in (
            ("order", self.order, ORDERS),
            ("grouping", self.grouping, GROUPINGS),
            ("packaging", self.packaging, PACKAGINGS),
        ):
            if name not in known:
                raise UnknownNameError(kind, str(name), known)
        self._check_hashed()

    def _check_hashed(self) -> None:
        if not self.hashed:
            check_range(f"packet size with {self.grouping} grouping", self.packet_bytes, 0, 0)
            return
        check_range("packet size with hashed grouping", self.packet_bytes, MIN_PACKET_BYTES, MAX_DATAGRAM_BYTES)
        check_range("block size with hashed grouping", self.block_size, 1, MAX_HASHED_BLOCK)
        check_range("number of lanes with hashed grouping", self.lanes, 1, 1)
        if self.packaging != "atomic":
            raise InvalidValueError("hashed grouping knows atomic packaging only")

    @property
    def hashed(self) -> bool:
        """Whether packets are cut by their size, so that only a packet itself says which elements it holds."""
        return self.grouping == "hashed"

    @property
    def unit(self) -> str:
        """What a loss of one packet is called: `datagram` if packets are cut to fit one, else `pak`."""
        return "datagram" if self.hashed else "pak"

    @property
    def separated(self) -> bool:
        """Whether each attribute of some elements is in a packet of its own."""
        return self.packaging == "separated"

    @property
    def common(self) -> bool:
        """Whether elements of every codec can be packed so, whole and in Morton order, and not only HAC++'s anchors."""
        return not self.separated and self.order == "morton"


PRESETS = {
    "paper": Packetization(),
    "hacpp": Packetization(lanes=1, order="raster", grouping="contiguous", packaging="separated"),
    "datagram": Packetization(lanes=1, grouping="hashed", packet_bytes=DATAGRAM_BYTES),
}
"""Named packetizations: the paper's, HAC++'s own layout (the baseline it is measured against: 3000 anchors in raster
order to a batch), and packets that fit a datagram."""

SPREAD = "spread"
"""Name of what `spread_packetization` returns; `packetization_named` knows it beside `PRESETS`."""
_PACKET_ELEMENTS, _FEWEST_LANES = 375, 8
"""As many as the paper's packets and blocks have."""


def spread_packetization(num_elements: int) -> Packetization:
    """Returns lanes over the whole scene: one block, or as few as there can be, in packets of at most 375 elements.

    In blocks of 3000 in 8 lanes the loss of a packet takes an eighth of what is there, and of two packets a quarter:
    neighbours often share their fate. At equal bytes and 20 % loss, lego is 0.30 to 0.44 dB better with these, and the
    worst of 16 losses 0.6 dB; snowmiku_small gains 0.0 to 0.06 dB (`benchmarks/results/spread.json`).

    Args:
        num_elements: Elements that will be coded.
    """
    blocks = max(1, -(-num_elements // MAX_BLOCK_SIZE))
    size = max(1, -(-num_elements // blocks))
    return Packetization(block_size=size, lanes=max(_FEWEST_LANES, -(-size // _PACKET_ELEMENTS)))


def packetization_named(name: str | None, schema: str, num_elements: int) -> Packetization:
    """Returns a packetization by its name, for a scene.

    Args:
        name: `SPREAD` or a key of `PRESETS`; where absent what suits the elements (`StreamSchema.spread`).
        schema: What codes them, a name in `SCHEMAS`.
        num_elements: How many of them will be coded.

    Raises:
        UnknownNameError: If there is no such name.
    """
    name = name or (SPREAD if SCHEMAS[schema].spread else "paper")
    if name == SPREAD:
        return spread_packetization(num_elements)
    if name not in PRESETS:
        raise UnknownNameError("preset", name, (SPREAD, *PRESETS))
    return PRESETS[name]
