"""Limits of a server on its clients."""

from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.transport.congestion.pacing import MAX_RATE, START_RATE


@dataclass(frozen=True)
class ServerLimits:
    """Limits of a server on its clients.

    Attributes:
        sessions: Maximum number of concurrent transfers.
        per_network: Maximum number of concurrent transfers to one network: an IPv4 address, or a /64 prefix of IPv6. A
            network may start twice this number of transfers per minute.
        silence_s: Time without datagrams of a client after which its transfer ends, seconds.
        rate: Maximum sending rate per client, bytes per second.
        start_rate: Maximum sending rate per client before the first feedback, bytes per second.
        fixed_rate: Constant sending rate per client, bytes per second; None for rate control.
        total_rate: Maximum sending rate to all clients together, bytes per second, HTTP included; None for no maximum.
        max_sent_ratio: Maximum bytes sent to a client, divided by the bytes of the complete stream.

    Raises:
        InvalidValueError: If `sessions` is negative, or another number is not above 0.
    """

    sessions: int = 256
    per_network: int = 16
    silence_s: float = 5.0
    rate: float = MAX_RATE
    start_rate: float = START_RATE
    fixed_rate: float | None = None
    total_rate: float | None = None
    max_sent_ratio: float = 4.0

    def __post_init__(self) -> None:
        check_fields(self)
        whole_number(self.sessions, "sessions")
        whole_number(self.per_network, "per_network", 1)
        for name in ("silence_s", "rate", "start_rate", "fixed_rate", "total_rate", "max_sent_ratio"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InvalidValueError(f"{name}: expected a number above 0, not {shown(value)}")
