"""Options of a receiver: requested stream, time limits, retransmission, viewpoint."""

import math
from dataclasses import dataclass, field

from splatwire.arguments import check_fields
from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.errors import InvalidValueError
from splatwire.transport.protocol.collect import ReceiverLimits
from splatwire.transport.protocol.messages import MAX_NAME, MAX_SCENE_TOKEN


@dataclass(frozen=True)
class ReceiverOptions:
    """Options of a receiver.

    Attributes:
        name: Name of the requested stream; an empty name requests the server's first stream.
        scene_token: Signed token that opens private scenes, ASCII; empty without one. Only for encrypted paths.
        deadline_s: Time after which the transfer ends with the received data, seconds; None for no limit.
        nack: True to request retransmission of lost packets.
        silence_s: Idle timeout of a connection (QUIC), seconds.
        reconnect_s: Time in which the receiver tries to reconnect to a silent server before the transfer fails,
            seconds.
        limits: Maximum accepted sizes of a stream.
        viewpoint: Initial viewpoint: only packets visible from there are sent; None to receive all packets.
        keep_open: True to wait for further viewpoints after everything visible was received.
    """

    name: str = ""
    scene_token: str = field(default="", repr=False)
    deadline_s: float | None = None
    nack: bool = True
    silence_s: float = 4.0
    reconnect_s: float = 60.0
    limits: ReceiverLimits = field(default_factory=ReceiverLimits)
    viewpoint: Viewpoint | None = None
    keep_open: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.deadline_s is not None and not self.deadline_s > 0:
            raise InvalidValueError(f"a deadline must be above 0 seconds, {self.deadline_s} is not")
        if not self.silence_s > 0:
            raise InvalidValueError(f"silence_s is above 0 seconds, {self.silence_s} is not")
        if not 0 <= self.reconnect_s < math.inf:
            raise InvalidValueError(f"reconnect_s is 0 or more seconds, {self.reconnect_s} is not")
        check_stream_name(self.name)
        if len(self.scene_token) > MAX_SCENE_TOKEN or not (
            self.scene_token.isascii() and self.scene_token.isprintable()
        ):
            raise InvalidValueError(f"a token for private scenes is printable ASCII of at most {MAX_SCENE_TOKEN} bytes")


def check_stream_name(name: str) -> None:
    """Checks that requests can contain the name of a stream: servers ignore others.

    Raises:
        InvalidValueError: If the name is longer than `MAX_NAME` bytes, or not printable.
    """
    if not name.isprintable() or len(name.encode()) > MAX_NAME:
        raise InvalidValueError(f"the name of a stream has at most {MAX_NAME} bytes, all printable")
