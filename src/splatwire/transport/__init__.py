"""Transport of streams over networks that lose datagrams.

The protocol core uses no sockets and no clock: callers pass datagrams and the time. No module of this package imports
torch.
"""

from splatwire.transport.protocol.collect import ReceiverLimits
from splatwire.transport.protocol.events import (
    Event,
    Finished,
    PacketArrived,
    SideInfoArrived,
    StreamReplaced,
    Welcomed,
)
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.receiver import Receiver
from splatwire.transport.protocol.receiver_options import ReceiverOptions
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.served_stream import ServedStream, make_served_stream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.transfer import ServerTransfer

__all__ = [
    "Event",
    "Finished",
    "PacketArrived",
    "Protection",
    "Receiver",
    "ReceiverLimits",
    "ReceiverOptions",
    "ServedStream",
    "Server",
    "ServerLimits",
    "ServerTransfer",
    "SideInfoArrived",
    "StreamReplaced",
    "Welcomed",
    "make_served_stream",
]
