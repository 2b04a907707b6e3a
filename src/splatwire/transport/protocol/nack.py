"""NACK tracker of a receiver: decides when a missing packet is requested again."""

import sys
from collections.abc import Iterable

from splatwire.transport.protocol.messages import MAX_NACKS

# Several modules limit requests and retransmissions. Limits of a receiver:
#
# * no NACKs at all without `ReceiverOptions.nack`;
# * interval between feedback datagrams: `receiver.FEEDBACK_INTERVAL_S`; with a view-dependent order, half of
#   `receiver.IDLE_S` once everything visible has arrived;
# * interval between NACKs for a packet: `NACK_INTERVAL_S`;
# * number of NACKs per packet of a live stream, and per sequence number: `MAX_NACK_ATTEMPTS` (a packet of a still scene
#   has no maximum);
# * number of missing sequence numbers that are stored: `gap_tracker.MAX_GAPS`;
# * number of NACKs per feedback datagram: `messages.MAX_NACKS`; after `receiver.SUSPECT_ENDS` successive
#   `End` datagrams without a new packet, `receiver.MAX_SMALL_NACKS`;
# * number of later packets after which a packet counts as missing: `receiver.REORDER_THRESHOLD`;
# * number of successive `End` datagrams without a new packet, after which the receiver gives up:
#   `receiver.MAX_FRUITLESS_ENDS`; and time without anything new, after which it gives up: `receiver.MAX_FRUITLESS_S`.
#
# Limits of a server:
#
# * number of feedback datagrams whose NACKs count: `transfer.MAX_REPORTS_S`, `transfer.MAX_REPORTS_AT_ONCE`; over QUIC
#   also the processor time of a client's datagrams (`quic.input_budget`);
# * interval between retransmissions of a packet or a symbol of the init segment: `transfer.RETRANSMIT_INTERVAL_S`, or
#   1.25 round-trip times if that is longer;
# * packets that are retransmitted at all: `may_retransmit` of the served stream. For a live stream, these are the
#   packets that are still needed: keyframe Gaussians and the packets of the newest group (`live_packager`). Otherwise,
#   these are the packets up to `Protection.retransmit_until`;
# * retransmitted bytes as a share of the stream: `Protection.retransmit_share`;
# * number of latest datagrams that NACKs may name by sequence number: `send_queue.MAX_LOGGED_DATAGRAMS`;
# * bytes sent to a client: `ServerLimits.max_sent_ratio`; nothing is sent after `transfer.FEEDBACK_TIMEOUT_S` without
#   feedback.
#
# The counterparts in browsers are `web/src/transport/transfer.ts`, and `webtransport.ts` with its own limits of time.
# `web/scripts/make_tables.py` copies limits of a receiver to `web/src/transport/wire.ts`. `docs/transport.md` states
# `NACK_INTERVAL_S`, `MAX_NACK_ATTEMPTS` and `REORDER_THRESHOLD`, `docs/wire.md` states `MAX_NACKS`.

NACK_INTERVAL_S = 0.12
"""Minimum interval between NACKs for the same packet, seconds."""
MAX_NACK_ATTEMPTS = 8
"""Maximum number of NACKs per packet of a live stream, for keyframe Gaussians and motion alike. Also the maximum per
sequence number, for streams with view-dependent order (`gap_tracker`).
"""


class NackTracker:
    """Tracks which missing packets a receiver has already requested (NACKs), and when.

    Attributes:
        max_attempts: Maximum number of NACKs per packet.
        exhausted: Index in sending order of the first packet that may still be requested. All missing packets before it
            have been requested `max_attempts` times.
    """

    def __init__(self) -> None:
        self.max_attempts = sys.maxsize
        self.exhausted = 0
        self._last: dict[int, tuple[float, int]] = {}

    def attempts(self, index: int) -> int:
        """Returns the number of NACKs sent so far for a packet.

        The packet is given by its index in sending order.
        """
        return self._last.get(index, (0.0, 0))[1]

    def forget(self, index: int) -> None:
        """Removes a received packet from the tracker."""
        self._last.pop(index, None)

    def __bool__(self) -> bool:
        return bool(self._last)

    def due(self, missing: Iterable[int], now: float) -> list[int]:
        """Returns the missing packets to request now, and records a NACK for each.

        Packets that were requested recently, or too often, are left out.

        Args:
            missing: Indices of the missing packets in sending order, ascending.
            now: Time, seconds.
        """
        out: list[int] = []
        exhausted = True
        for index in missing:
            at, attempts = self._last.get(index, (-NACK_INTERVAL_S, 0))
            exhausted = exhausted and attempts >= self.max_attempts
            if exhausted:
                self.exhausted = index + 1
                self.forget(index)
                continue
            if now - at >= NACK_INTERVAL_S and attempts < self.max_attempts:
                self._last[index] = now, attempts + 1
                out.append(index)
                if len(out) == MAX_NACKS:
                    break
        return out
