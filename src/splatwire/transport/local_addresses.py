"""Local addresses of a server that listens on all addresses of its machine.

Clients ignore a datagram from another address than the one that they have sent to. Without this module, the kernel
would choose the sender's address of a response by the route to the client, which is another one on machines with
several addresses, such as a floating address.
"""

import socket
import struct
import sys
from collections.abc import Sequence
from typing import Any

_IP_PKTINFO = 8
"""Socket option and control message of Linux for IPv4 (linux/in.h); the module `socket` lacks it in Python 3.11."""
_IPV4, _IPV6 = struct.Struct("=i4s4s"), struct.Struct("=16si")
"""Structures `in_pktinfo` and `in6_pktinfo`."""
_CONTROL_BYTES = 64
"""Size of the buffer for control messages, bytes."""
_LINK_LOCAL = b"\xfe\x80"
_MAX_CLIENTS = 1 << 14
"""Maximum number of clients whose local addresses are stored. Beyond it, all are forgotten, and stored again with the
next datagram of their clients.
"""


class LocalAddresses:
    """Receives and sends datagrams of sockets that are bound to all addresses.

    Each datagram to a client is sent from the local address to which the client has sent its last one, as long as that
    address is stored (`_MAX_CLIENTS`).

    Args:
        sockets: The sockets, all of one family.
    """

    def __init__(self, sockets: Sequence[socket.socket]) -> None:
        is_ipv6 = sockets[0].family == socket.AF_INET6
        self._level, self._kind = (
            (socket.IPPROTO_IPV6, socket.IPV6_PKTINFO) if is_ipv6 else (socket.IPPROTO_IP, _IP_PKTINFO)
        )
        self._to_control = _ipv6_control if is_ipv6 else _ipv4_control
        self._controls: dict[Any, bytes] = {}
        for one in sockets:
            one.setsockopt(self._level, socket.IPV6_RECVPKTINFO if is_ipv6 else _IP_PKTINFO, 1)

    def receive(self, source: socket.socket, max_bytes: int) -> tuple[bytes, Any]:
        """Receives a datagram; returns its payload and the address of the client.

        Args:
            source: Socket to read.
            max_bytes: Maximum size of the payload, bytes.

        Raises:
            OSError: As `recvmsg` of the socket, such as `BlockingIOError` if there is no datagram.
        """
        data, controls, _, address = source.recvmsg(max_bytes, _CONTROL_BYTES)
        for level, kind, content in controls:
            if level == self._level and kind == self._kind:
                if len(self._controls) >= _MAX_CLIENTS and address not in self._controls:
                    self._controls.clear()
                self._controls[address] = self._to_control(content)
        return data, address

    def send(self, sender: socket.socket, data: bytes, address: Any) -> None:
        """Sends a datagram to a client.

        Args:
            sender: Socket that sends it.
            data: Payload of the datagram.
            address: Address of the client.

        Raises:
            OSError: As `sendmsg` of the socket, such as `BlockingIOError` if its buffer is full.
        """
        control = self._controls.get(address)
        if control is None:
            sender.sendto(data, address)
        else:
            sender.sendmsg([data], [(self._level, self._kind, control)], 0, address)


def local_addresses(sockets: Sequence[socket.socket]) -> LocalAddresses | None:
    """Returns the local addresses of sockets; None if one address is bound, or the system does not tell them."""
    if sys.platform != "linux" or sockets[0].getsockname()[0] not in ("0.0.0.0", "::"):
        return None
    try:
        return LocalAddresses(sockets)
    except OSError:  # emulated systems
        return None


def _ipv4_control(content: bytes) -> bytes:
    """Returns the control message that sends from the local address of a received one, over any interface."""
    _, local, _ = _IPV4.unpack(content)
    return _IPV4.pack(0, local, bytes(4))


def _ipv6_control(content: bytes) -> bytes:
    """Like `_ipv4_control`. Link-local addresses need their interface."""
    local, interface = _IPV6.unpack(content)
    return _IPV6.pack(local, interface if local.startswith(_LINK_LOCAL) else 0)
