"""What the datagrams of the transport say; `splatwire.transport.wire` has their bytes."""

from typing import NamedTuple

MAX_NAME = 64
MAX_NACKS = 250
MAX_TIERS = 130
"""Runs of packets. A scene has ten at most: eight tiers, what is in the head object, what has no parity; a clip has no
preview, and two for each group of frames."""
MAX_PREVIEW = 1024
"""Most bytes of a preview."""
MAX_DECLARED = MAX_PREVIEW + 8 * 10
"""Most bytes of a preview and of runs, eight each: a welcome is a datagram of 1180 bytes."""
MAX_HELD_BYTES = 1100
"""Most bytes of a `Have`, eight packets to a byte."""
TOKEN_BYTES = 16
DIGEST_BYTES = 32

REFUSALS = (
    "", "no such stream", "the server is full", "the server stopped", "too many transfers from this network",
    "nothing is there yet",
)  # fmt: skip
NOT_YET = 5
"""The one reason after which a client asks again."""


class Hello(NamedTuple):
    """A client greets: `nonce` names the attempt, `name` the stream it wants (empty: the server's only one)."""

    nonce: int
    name: str


class Challenge(NamedTuple):
    """The server gives an address a token; it remembers nothing yet."""

    nonce: int
    token: bytes


class Request(NamedTuple):
    """The client shows that it reads what is sent to its address."""

    nonce: int
    token: bytes
    name: str


class TierHead(NamedTuple):
    """Protection of a run of packets, in sending order.

    Attributes:
        num_packets: Packets of the run.
        groups: Parity groups that they are dealt to in turn; 0 if they have no parity.
        repair: Repair symbols of each group.
    """

    num_packets: int
    groups: int
    repair: int


MORE = TierHead(0, 0, 1)
"""The last run of a stream that grows: of no packets. A receiver that does not know it takes what is there by now."""


VIEWS = TierHead(0, 0, 2)
"""The last run of a stream of which the server sends first what a `View` looks at; others do not mind it."""
BY_SEQUENCE = 1 << 31
"""Added to the number of a datagram that is asked for again by it: where views order what is sent, a receiver cannot
know which packets have left."""


class Welcome(NamedTuple):
    """What will be sent; of a stream that grows (`MORE`), what there is by now.

    Attributes:
        nonce: Of the request.
        session: Id of the transfer.
        stream_id: Id that every packet carries.
        object_bytes: Size of the head object (manifest, side information, and the packets that share its protection).
        digest: SHA-256 of the head object.
        symbol_bytes: Size of its symbols.
        num_packets: Packets of the complete stream.
        packet_bytes: Most bytes of one.
        carried: Packets in the head object: the first ones in sending order.
        tiers: Protection of the packets; together they are all packets.
        preview: Something to show until the scene is there; not looked into here, and empty where there is none.
    """

    nonce: int
    session: int
    stream_id: int
    object_bytes: int
    digest: bytes
    symbol_bytes: int
    num_packets: int
    packet_bytes: int
    carried: int
    tiers: tuple[TierHead, ...]
    preview: bytes = b""

    @property
    def open(self) -> bool:
        """Whether the stream grows: another welcome of the same session will say more."""
        return self.tiers[-1] == MORE

    @property
    def viewable(self) -> bool:
        """Whether what is looked at comes first, once the server is told."""
        return self.tiers[-1] == VIEWS


class Side(NamedTuple):
    """A symbol of the head object."""

    session: int
    sequence: int
    segment: int
    symbol: int
    payload: bytes


class Data(NamedTuple):
    """A packet of the stream; `place` is its index in the sending order."""

    session: int
    sequence: int
    place: int
    packet: bytes


class Parity(NamedTuple):
    """A repair symbol of a parity group; `symbol` counts repair symbols only, from 0."""

    session: int
    sequence: int
    group: int
    symbol: int
    payload: bytes


class Feedback(NamedTuple):
    """What arrived so far.

    Attributes:
        session: Id of the transfer.
        largest: Largest sequence number that arrived.
        received: Datagrams with a sequence number that arrived.
        time_us: The receiver's clock when `largest` arrived, microseconds modulo 2**32.
        side_missing: Symbols of the head object that are needed yet; 0 when it is complete.
        nacks: Packets asked for again, by index, or by the sequence number of their datagram and `BY_SEQUENCE`.
    """

    session: int
    largest: int
    received: int
    time_us: int
    side_missing: int
    nacks: tuple[int, ...] = ()


class Bye(NamedTuple):
    """The client needs nothing more."""

    session: int


class Have(NamedTuple):
    """What a client has from before, said behind its request: none of it is sent unless it is asked for again.

    Attributes:
        nonce: Of the request.
        stream_id: The stream that it is of; where another one is sent, nothing is left out.
        head: 1 with manifest and side information.
        first: Index of the first packet that is spoken of, a multiple of 8.
        held: A bit for each packet from there on, the lowest of a byte first.
    """

    nonce: int
    stream_id: int
    head: int
    first: int
    held: bytes


class View(NamedTuple):
    """Where the client looks from, at most ten times a second.

    Attributes:
        session: Id of the transfer.
        number: Counts the client's views.
        budget: Gaussians that it shows at most.
        width: Of the picture, pixels.
        height: Of the picture, pixels.
        focal: Focal length, pixels.
        viewmat: World to camera (x right, y down, z ahead), the first three rows of the matrix, one after another.
    """

    session: int
    number: int
    budget: int
    width: int
    height: int
    focal: float
    viewmat: tuple[float, ...]


class Refuse(NamedTuple):
    """The server says no; `reason` is an index into `REFUSALS`."""

    nonce: int
    reason: int


class End(NamedTuple):
    """Everything was sent once."""

    session: int
    sequence: int


Frame = Hello | Challenge | Request | Welcome | Side | Data | Parity | Feedback | Bye | Refuse | End | Have | View
