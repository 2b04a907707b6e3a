"""Events that a receiver reports to its caller during a transfer."""

from dataclasses import dataclass

from splatwire.bitstream import Manifest, Packet, PacketIntake, SceneStream
from splatwire.transport.protocol.datagrams import Welcome


@dataclass(frozen=True)
class Welcomed:
    """The server has accepted the request: its first response with the sizes of the stream (welcome) was received.

    Attributes:
        num_packets: Number of packets of the complete stream.
        head_bytes: Size of the init segment in bytes: manifest, side information and bundled packets.
        preview: Preview to show until the init segment is received (`splatwire.codec.preview`); empty without a
            preview.
        is_live: True for a live stream, whose number of packets grows: further events of this type follow.
    """

    num_packets: int
    head_bytes: int
    preview: bytes = b""
    is_live: bool = False

    @staticmethod
    def of(frame: Welcome) -> "Welcomed":
        """Creates the event from the datagram with which the server has accepted the request.

        Args:
            frame: The datagram, which contains the sizes of the stream.
        """
        return Welcomed(frame.num_packets, frame.object_bytes, frame.preview, frame.is_live)


@dataclass(frozen=True)
class SideInfoArrived:
    """Manifest and side information are complete; the scene can be decoded from now on.

    Attributes:
        manifest: Manifest of the stream.
        side_info: Side information, checked against the manifest.
        intake: Filter that checks packets against the manifest; every reported packet has passed the filter.
    """

    manifest: Manifest
    side_info: bytes
    intake: PacketIntake


@dataclass(frozen=True)
class PacketArrived:
    """A packet was received, or recovered from repair symbols.

    Packets received before the side information are reported right after `SideInfoArrived`.

    Attributes:
        packet: Valid packet of the stream.
        repaired: True if the packet was lost and recovered from repair symbols.
    """

    packet: Packet
    repaired: bool


@dataclass(frozen=True)
class StreamReplaced:
    """The server continues with a new stream, such as the next period of a live sequence; earlier data are dropped.

    Attributes:
        stream: Previous stream with the packets that were received.
    """

    stream: SceneStream


@dataclass(frozen=True)
class Interrupted:
    """No datagrams arrive any more, or the connection was closed; the receiver tries to reconnect."""


@dataclass(frozen=True)
class Resumed:
    """The server has responded again after an interruption.

    Attributes:
        kept: True if the data received before are kept and the transfer continues; False if the server now sends
            another stream from its start.
    """

    kept: bool


@dataclass(frozen=True)
class Finished:
    """The transfer has ended.

    Attributes:
        reason: `complete` (every packet was received), `sent` (everything was sent, but packets are missing), `seen`
            (everything visible was received), `deadline` (time limit of the client), or an error message.
        ok: True if manifest and side information were received, so that a scene can be decoded.
    """

    reason: str
    ok: bool


Event = Welcomed | SideInfoArrived | PacketArrived | StreamReplaced | Interrupted | Resumed | Finished
