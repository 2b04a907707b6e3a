"""Messages of the wire protocol as named tuples (docs/wire.md).

Each datagram carries one message. On the reliable stream of QUIC, each message follows its size (u16).
"""

from typing import NamedTuple

MAX_NAME = 64
MAX_NACKS = 250
"""Maximum number of NACKs in one feedback datagram."""
MAX_PARITY_RANGES = 130
"""Maximum number of parity ranges. A range is a series of packets in sending order with the same parity. A static scene
has at most ten ranges: eight importance tiers, bundled packets, packets without parity. A sequence has two ranges for
each group of pictures, and no preview, which leaves space for them in the welcome.
"""
MAX_PREVIEW = 1024
"""Maximum size of a scene's preview in bytes."""
MAX_DECLARED = MAX_PREVIEW + 8 * 10
"""Maximum size in bytes of the preview plus the descriptions of parity ranges (eight bytes each), so that the server's
first response (welcome) fits one datagram, with 1181 bytes.
"""
MAX_HELD_BYTES = 1100
"""Maximum size in bytes of the bit mask of received packets in a `Have` datagram; eight packets per byte."""
TOKEN_BYTES = 16
MAX_SCENE_TOKEN = 1024
"""Maximum size of a signed token that opens private scenes, bytes, so that the request fits one datagram."""
DIGEST_BYTES = 32

REFUSALS = (
    "", "no such stream", "the server is full", "the server stopped", "too many transfers from this network",
    "nothing is there yet", "the server has another protocol version", "the scene needs a valid token",
    "the port serves another transport",
)  # fmt: skip
NOT_YET, OTHER_VERSION, NEEDS_TOKEN, OTHER_TRANSPORT = 5, 6, 7, 8
"""Indices in `REFUSALS`: no stream is available yet, after which a client retries; the protocol version of the client
differs; the requested scene is private, and the request has no valid token for it; the port serves QUIC to a client of
plain UDP, or plain UDP to a client of QUIC.
"""


class Hello(NamedTuple):
    """First datagram of a client.

    Attributes:
        nonce: Random number that identifies the client's connection attempt.
        name: Name of the requested stream; an empty name requests the server's first stream.
    """

    nonce: int
    name: str


class Challenge(NamedTuple):
    """Server's response to `Hello`, with a token that the client must return in `Request`.

    Attributes:
        nonce: Number that identifies the client's connection attempt.
        token: Token that only the owner of the client's address receives.
    """

    nonce: int
    token: bytes


class Request(NamedTuple):
    """Request of a client for a stream.

    Attributes:
        nonce: Number that identifies the client's connection attempt.
        token: Token that the server has sent to the client's address.
        name: Name of the requested stream; an empty name requests the server's first stream.
        scene_token: Signed token that opens private scenes, ASCII; empty without one. Only on encrypted paths.
    """

    nonce: int
    token: bytes
    name: str
    scene_token: str = ""


class ParityRange(NamedTuple):
    """Parity (repair symbols) of a range of consecutive packets.

    The range is divided into parity groups, and each group has repair symbols for its packets.

    Attributes:
        num_packets: Number of packets of the range.
        groups: Number of interleaved parity groups; 0 without parity.
        repair: Number of repair symbols per parity group. 0 without parity, and for earlier groups of a live
            stream, whose symbols are dropped: the numbers of their parity groups stay taken.
    """

    num_packets: int
    groups: int
    repair: int


class Welcome(NamedTuple):
    """Response of the server that accepts a request and declares the sizes of the stream.

    For a live stream, the server sends such a response again whenever the stream has grown.

    Attributes:
        nonce: Number that identifies the client's connection attempt.
        session: Id of the transfer, contained in all its datagrams.
        stream_id: Id of the stream, contained in every packet.
        init_segment_bytes: Size of the init segment in bytes: manifest, side information and bundled packets.
        digest: SHA-256 of the init segment.
        symbol_bytes: Size of the init segment's symbols (erasure code) in bytes.
        num_packets: Number of packets of the complete stream; for a live stream, of the packets so far.
        max_packet_bytes: Maximum size of a packet in bytes.
        num_bundled: Number of packets at the start of the sending order that are bundled in the init segment.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
        preview: Preview to show until the scene is decoded; empty without a preview.
        is_live: True for a live stream that may still grow; False in the final state of one.
        view_dependent: True if the order of the packets depends on the client's viewpoint: visible packets come first.
    """

    nonce: int
    session: int
    stream_id: int
    init_segment_bytes: int
    digest: bytes
    symbol_bytes: int
    num_packets: int
    max_packet_bytes: int
    num_bundled: int
    parity_ranges: tuple[ParityRange, ...]
    preview: bytes = b""
    is_live: bool = False
    view_dependent: bool = False


class InitSymbol(NamedTuple):
    """Datagram with a source or repair symbol of the init segment (manifest, side information, bundled packets).

    Attributes:
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
        source_block: Index of the source block: part of the init segment that is coded separately.
        symbol: Index of the symbol in the source block; source symbols come first, then repair symbols.
        payload: Bytes of the symbol.
    """

    session: int
    sequence: int
    source_block: int
    symbol: int
    payload: bytes


class Data(NamedTuple):
    """Datagram with one packet of the stream.

    Attributes:
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
        packet_index: Index of the packet in sending order.
        packet: Bytes of the packet.
    """

    session: int
    sequence: int
    packet_index: int
    packet: bytes


class Parity(NamedTuple):
    """Datagram with a repair symbol of a parity group (packets that share repair symbols).

    Attributes:
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
        group: Index of the parity group.
        symbol: Index of the repair symbol in the group.
        payload: Bytes of the symbol.
    """

    session: int
    sequence: int
    group: int
    symbol: int
    payload: bytes


class Feedback(NamedTuple):
    """Feedback report of a receiver.

    Attributes:
        session: Id of the transfer.
        largest: Largest received sequence number.
        received: Number of received datagrams with a sequence number.
        time_us: Receiver's clock when `largest` was received, microseconds modulo 2**32.
        symbols_missing: Number of symbols of the init segment that are still needed.
        nacks: Packets to retransmit: their indices in sending order.
        lost_sequences: Datagrams to retransmit: their sequence numbers. Used instead of `nacks` if the order of the
            packets depends on the viewpoint.
    """

    session: int
    largest: int
    received: int
    time_us: int
    symbols_missing: int
    nacks: tuple[int, ...] = ()
    lost_sequences: tuple[int, ...] = ()


class Bye(NamedTuple):
    """Datagram with which the client ends a transfer."""

    session: int


class Have(NamedTuple):
    """List of packets that a client already has when it resumes a transfer.

    Attributes:
        nonce: Number that identifies the client's connection attempt.
        stream_id: Id of the stream that the packets belong to.
        has_init_segment: 1 if the client has manifest and side information, else 0.
        first: Index in sending order of the first packet in the mask, a multiple of 8.
        held: Bit mask of received packets from index `first` on, least significant bit first.
    """

    nonce: int
    stream_id: int
    has_init_segment: int
    first: int
    held: bytes


class ViewUpdate(NamedTuple):
    """Viewpoint of the client, with which the server sends visible packets first.

    Attributes:
        session: Id of the transfer.
        number: Number of the update, increasing.
        budget: Maximum number of Gaussians that the client renders.
        width: Width of the rendered picture, pixels.
        height: Height of the rendered picture, pixels.
        focal: Focal length, pixels.
        viewmat: World-to-camera matrix (x right, y down, z forward), its first three rows, row-major.
    """

    session: int
    number: int
    budget: int
    width: int
    height: int
    focal: float
    viewmat: tuple[float, ...]


class Refuse(NamedTuple):
    """Response of the server that refuses a request.

    Attributes:
        nonce: Number that identifies the client's connection attempt.
        reason: Reason for the refusal, as an index into `REFUSALS`.
    """

    nonce: int
    reason: int


class End(NamedTuple):
    """Datagram that a server sends when it has sent everything once. Retransmissions may follow.

    New packets may also follow: in a live stream, and after a view update.

    Attributes:
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
    """

    session: int
    sequence: int


Message = (
    Hello | Challenge | Request | Welcome | InitSymbol | Data | Parity | Feedback | Bye | Refuse | End | Have
    | ViewUpdate
)  # fmt: skip
