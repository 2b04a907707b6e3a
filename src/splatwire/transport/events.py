"""What a receiver tells its owner."""

from dataclasses import dataclass

from splatwire.packets import Manifest, Packet, PacketIntake, SceneStream
from splatwire.transport.frames import Welcome


@dataclass(frozen=True)
class Welcomed:
    """The server will send a stream.

    Attributes:
        num_packets: Packets of the complete stream.
        head_bytes: Bytes of manifest and side information.
        preview: What can be shown until they are there (`splatwire.codec.preview`), if it can be read; empty where the
            stream has none.
        open: Whether the stream grows: the server will say so again, with more packets.
    """

    num_packets: int
    head_bytes: int
    preview: bytes = b""
    open: bool = False

    @staticmethod
    def of(frame: Welcome) -> "Welcomed":
        """What a welcome says."""
        return Welcomed(frame.num_packets, frame.object_bytes, frame.preview, frame.open)


@dataclass(frozen=True)
class SideInfoArrived:
    """From now on the scene can be decoded at any time.

    Attributes:
        manifest: The stream's manifest.
        side_info: Its side information, checked against the manifest.
        intake: What every packet passed that is told of.
    """

    manifest: Manifest
    side_info: bytes
    intake: PacketIntake


@dataclass(frozen=True)
class PacketArrived:
    """A packet is there; packets that came before the side information are told right after it.

    Attributes:
        packet: The packet.
        repaired: Whether parity brought it back.
    """

    packet: Packet
    repaired: bool


@dataclass(frozen=True)
class StreamLeft:
    """Another stream follows, of a live clip its next chapter; what came of the one before is forgotten here.

    Attributes:
        stream: What came.
    """

    stream: SceneStream


@dataclass(frozen=True)
class Interrupted:
    """The server fell silent, or the connection to it ended: the receiver greets again."""


@dataclass(frozen=True)
class Resumed:
    """The server answers again.

    Attributes:
        kept: Whether what arrived before is kept; else the server sends another stream, and all begins again.
    """

    kept: bool


@dataclass(frozen=True)
class Finished:
    """Nothing more will come.

    Attributes:
        reason: `complete`, `sent` (everything was sent, something is missing), `seen` (what is looked at came),
            `deadline`, or a sentence that says what went wrong.
        ok: Whether there is a scene to decode.
    """

    reason: str
    ok: bool


Event = Welcomed | SideInfoArrived | PacketArrived | StreamLeft | Interrupted | Resumed | Finished
