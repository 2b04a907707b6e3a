"""Events that a receiver reports to its caller during a transfer."""

import warnings
from dataclasses import dataclass

from splatwire.bitstream import Manifest, Packet, PacketIntake, SceneStream
from splatwire.reprs import summary_repr
from splatwire.transport.protocol.messages import Welcome


@dataclass(frozen=True)
class Welcomed:
    """The server has accepted the request and declared the sizes of the stream.

    Attributes:
        num_packets: Number of packets of the complete stream.
        init_segment_bytes: Size of the init segment in bytes: manifest, side information and bundled packets.
        preview: Preview to show until the scene can be decoded; empty without a preview.
        is_live: True for a live stream that may still grow; this event is then repeated whenever it has grown.
    """

    num_packets: int
    init_segment_bytes: int
    preview: bytes = b""
    is_live: bool = False

    __repr__ = summary_repr

    @property
    def head_bytes(self) -> int:
        """Deprecated name of `init_segment_bytes`."""
        warnings.warn("Welcomed.head_bytes is deprecated, use init_segment_bytes", DeprecationWarning, stacklevel=2)
        return self.init_segment_bytes

    @staticmethod
    def of(message: Welcome) -> "Welcomed":
        """Creates the event from the server's response.

        Args:
            message: The response, with the sizes of the stream.
        """
        return Welcomed(message.num_packets, message.init_segment_bytes, message.preview, message.is_live)


@dataclass(frozen=True)
class NotBegun:
    """The server has no data of the stream, such as before the first frame of a live sequence. The receiver waits."""


@dataclass(frozen=True)
class SideInfoArrived:
    """Manifest and side information are complete; the scene can be decoded from now on.

    Attributes:
        manifest: Manifest of the stream.
        side_info: Side information of the stream (data that all packets need).
        intake: Filter that checks packets against the manifest.
    """

    manifest: Manifest
    side_info: bytes
    intake: PacketIntake

    __repr__ = summary_repr


@dataclass(frozen=True)
class PacketArrived:
    """A packet was received, or recovered from repair symbols.

    Attributes:
        packet: The packet, which is valid.
        repaired: True if the packet was recovered from repair symbols.
    """

    packet: Packet
    repaired: bool


@dataclass(frozen=True)
class StreamReplaced:
    """The server continues with a new stream, such as the next period of a live sequence.

    Attributes:
        stream: Previous stream with the packets that were received.
    """

    stream: SceneStream


@dataclass(frozen=True)
class Interrupted:
    """The server is silent or the connection was closed; the receiver tries to reconnect."""


@dataclass(frozen=True)
class Resumed:
    """The server has responded again after an interruption.

    Attributes:
        kept: True if the data received before are kept; False if the transfer starts again with another stream.
    """

    kept: bool


@dataclass(frozen=True)
class Finished:
    """The transfer has ended.

    Attributes:
        reason: `complete` (every packet was received), `sent` (everything was sent, but packets are missing), `seen`
            (everything visible was received), `deadline` (time limit of the client), or an error message.
        ok: True if a scene can be decoded from the received data.
    """

    reason: str
    ok: bool


Event = NotBegun | Welcomed | SideInfoArrived | PacketArrived | StreamReplaced | Interrupted | Resumed | Finished
