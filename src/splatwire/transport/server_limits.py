"""What a server spends on clients."""

from dataclasses import dataclass

from splatwire.transport.pacing import MAX_RATE, START_RATE


@dataclass(frozen=True)
class ServerLimits:
    """What a server spends on clients.

    Attributes:
        sessions: Transfers at once.
        per_network: Transfers at once to one network: an IPv4 address, or a /64 prefix of IPv6. Many people may share
            one; places for all of them belong to nobody alone. It may begin twice as many a minute.
        silence_s: A client that says nothing for so long is forgotten, seconds.
        rate: Most bytes per second to one client.
        start_rate: Bytes per second before the first feedback.
        fixed_rate: Bytes per second to every client, whatever it reports; None adapts.
        passes: A client gets at most this many times the bytes of one complete pass.
    """

    sessions: int = 256
    per_network: int = 16
    silence_s: float = 5.0
    rate: float = MAX_RATE
    start_rate: float = START_RATE
    fixed_rate: float | None = None
    passes: float = 4.0
