"""Transport: a stream over a network that loses datagrams. The core knows no socket and no clock; no torch here."""

from splatwire.transport.collect import ReceiverLimits
from splatwire.transport.events import Event, Finished, PacketArrived, SideInfoArrived, StreamLeft, Welcomed
from splatwire.transport.program import Program, make_program
from splatwire.transport.protection import Protection
from splatwire.transport.receiver import Receiver
from splatwire.transport.receiver_options import ReceiverOptions
from splatwire.transport.sender import Server
from splatwire.transport.server_limits import ServerLimits
from splatwire.transport.transfer import ServerTransfer

__all__ = [
    "Event",
    "Finished",
    "PacketArrived",
    "Program",
    "Protection",
    "Receiver",
    "ReceiverLimits",
    "ReceiverOptions",
    "Server",
    "ServerLimits",
    "ServerTransfer",
    "SideInfoArrived",
    "StreamLeft",
    "Welcomed",
    "make_program",
]
