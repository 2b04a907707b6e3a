"""What a receiver wants."""

import math
from dataclasses import dataclass, field

from splatwire.errors import InvalidValueError
from splatwire.packets.view import Look
from splatwire.transport.collect import ReceiverLimits
from splatwire.transport.frames import MAX_NAME


@dataclass(frozen=True)
class ReceiverOptions:
    """What a receiver wants.

    Attributes:
        name: Stream; empty for the server's first.
        deadline_s: Seconds from the beginning after which it takes what is there; None waits for everything.
        nack: Whether lost packets are asked for again.
        silence_s: A connection (QUIC) on which nothing comes for so long is over, seconds.
        reconnect_s: Longest silence of a server that has welcomed it, seconds: meanwhile it greets again, and goes on
            with what has arrived. 0 gives up after `silence_s`.
        limits: What it is willing to hold.
        look: Where somebody looks from: what they see comes first, and nothing else. `Receiver.look` says so later.
        stays: Whether it waits for another look when all that is seen came.
    """

    name: str = ""
    deadline_s: float | None = None
    nack: bool = True
    silence_s: float = 4.0
    reconnect_s: float = 60.0
    limits: ReceiverLimits = field(default_factory=ReceiverLimits)
    look: Look | None = None
    stays: bool = False

    def __post_init__(self) -> None:
        if self.deadline_s is not None and not self.deadline_s > 0:
            raise InvalidValueError(f"a deadline must be above 0 seconds, {self.deadline_s} is not")
        if not 0 <= self.reconnect_s < math.inf:
            raise InvalidValueError(f"reconnect_s is 0 or more seconds, {self.reconnect_s} is not")
        if len(self.name.encode()) > MAX_NAME:
            raise InvalidValueError(f"the name of a stream has at most {MAX_NAME} bytes")
