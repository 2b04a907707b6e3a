"""Sockets of one UDP port among which the Linux kernel distributes datagrams.

A single socket loses datagrams of all clients once its receive buffer is full. In a group of sockets, the kernel uses
different buffers for new and for known clients, and distributes client addresses over several buffers. A flood from one
address and port then fills few of the buffers. A flood of first datagrams, even with forged addresses, fills the
buffers for new clients, but not the buffers for known clients.
"""

import asyncio
import ctypes
import enum
import logging
import secrets
import socket
import struct
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

from splatwire.transport.address import cannot_listen, check_port
from splatwire.transport.local_addresses import local_addresses
from splatwire.transport.protocol.wire import HELLO, REQUEST, VERSION

LOG = logging.getLogger(__name__)
SOCKET_BUFFER = 4 << 20
"""Size of send and receive buffers, bytes."""
NEW_BUFFER = 1 << 18
"""Size of the receive buffer of a socket for new clients, bytes. Datagrams that wait long in it are useless."""
TOKEN_PREFIX = b"SWRT"
"""First bytes of each token in a QUIC Retry packet. A token without these bytes comes from another server: a browser
keeps the token of an address and may present it to a later server there (RFC 9000, 8.1.3). Such a client is treated as
a new one.
"""
SOCKETS_PER_CLASS = 8
"""Number of sockets per class. Address and port of a client choose its socket.

Each datagram of `DatagramClass.NEW` goes at random to one of two halves. The client's network chooses the socket in
the first half, address and port choose it in the second half. A flood from one network, with many ports, then leaves
most sockets of the first half to other networks. A flood from one port leaves most sockets of the second half to
others. Datagrams of other classes are not distributed at random, which would change their order.
"""
_SO_ATTACH_REUSEPORT_CBPF = 51
_NET, _RANDOM = 0xFFF00000, 0xFFFFF000 + 56
"""Offsets of the IP header and of a random number (SKF_NET_OFF; SKF_AD_OFF, SKF_AD_RANDOM)."""
QUIC_2 = 0x6B3343CF
"""Number of QUIC version 2 (RFC 9369)."""
_LD_W, _LD_H, _LD_B, _LD_W_X, _LD_B_X, _LD_MEM, _LD_IMM, _ST = 0x20, 0x28, 0x30, 0x40, 0x50, 0x60, 0x00, 0x02
_ADD, _ADD_X, _MUL, _RSH, _AND, _TAX, _TXA = 0x04, 0x0C, 0x24, 0x74, 0x54, 0x07, 0x87
_JUMP, _JUMP_EQ, _JUMP_SET, _RETURN_A = 0x05, 0x15, 0x45, 0x16
"""Operation codes of classic BPF (linux/filter.h)."""

Instruction = tuple[int, int] | tuple[int, int, str, str] | str
"""A label, or an operation code with an operand. A comparison also has the labels to jump to if it holds or fails."""


class DatagramClass(enum.IntEnum):
    """Class of a datagram, which determines how the server handles the datagram.

    Attributes:
        NEW: First datagram of a client, which does not prove the client's address. Unreadable datagrams are also in
            this class.
        TOKEN: Request with a token for the client's address.
        KNOWN: Any other datagram, such as a datagram of an existing connection.
    """

    NEW = 0
    TOKEN = 1
    KNOWN = 2


TURN_DATAGRAMS = {DatagramClass.NEW: 16, DatagramClass.TOKEN: 32, DatagramClass.KNOWN: 64}
"""Maximum number of datagrams that are read from a socket in one turn of the event loop, by class. Sockets are read in
turn, and timers run between turns.
"""

UDP_CLASSES: tuple[Instruction, ...] = (
    (_LD_B, 0),
    (_AND, 0xF0),
    (_JUMP_EQ, VERSION << 4, "own", "new"),
    "own",
    (_LD_B, 0),
    (_AND, 0x0F),
    (_JUMP_EQ, HELLO, "new", "no hello"),
    "no hello",
    (_JUMP_EQ, REQUEST, "token", "known"),
)
"""Program that classifies datagrams of plain UDP by their kind."""
QUIC_CLASSES: tuple[Instruction, ...] = (
    (_LD_B, 0),
    (_JUMP_SET, 0x80, "long header", "known"),
    "long header",
    (_LD_W, 1),
    (_JUMP_EQ, 1, "version 1", "no version 1"),
    "no version 1",
    (_JUMP_EQ, QUIC_2, "version 2", "new"),
    "version 1",
    (_LD_B, 0),
    (_AND, 0x30),
    (_JUMP_EQ, 0x00, "initial", "known"),
    "version 2",
    (_LD_B, 0),
    (_AND, 0x30),
    (_JUMP_EQ, 0x10, "initial", "known"),
    "initial",  # the token follows both connection ids and its own size of one byte
    (_LD_B, 5),
    (_TAX, 0),
    (_LD_B_X, 6),
    (_ADD_X, 0),
    (_TAX, 0),
    (_LD_W_X, 8),
    (_JUMP_EQ, int.from_bytes(TOKEN_PREFIX, "big"), "token", "new"),
)
"""Program that classifies UDP datagrams of QUIC by their header."""


def group_program(classes: Sequence[Instruction], salts: tuple[int, int]) -> bytes:
    """Returns a program of classic BPF that chooses the socket of a datagram.

    Args:
        classes: Program that jumps to "new", "token" or "known".
        salts: Two odd numbers of 32 bits, which keep the sockets of an address secret.
    """
    class_labels: list[Instruction] = []
    for each in DatagramClass:
        class_labels += [
            each.name.lower(), (_LD_IMM, SOCKETS_PER_CLASS * each), (_ST, 0), (_JUMP, 0, "source", ""),
        ]  # fmt: skip
    return _assembled((
        *classes, *class_labels,
        "source", (_LD_B, _NET), (_RSH, 4), (_JUMP_EQ, 6, "IPv6", "IPv4"),
        "IPv4", (_LD_H, _NET + 20), (_ST, 1), (_LD_W, _NET + 12), (_JUMP, 0, "mix", ""),
        "IPv6", (_LD_H, _NET + 40), (_ST, 1), (_LD_W, _NET + 8), (_MUL, salts[1]), (_TAX, 0), (_LD_W, _NET + 12),
        (_ADD_X, 0),
        "mix", (_MUL, salts[0]), (_TAX, 0), (_LD_MEM, 0), (_JUMP_EQ, 0, "new client", "by port"),
        "new client", (_LD_W, _RANDOM), (_JUMP_SET, 1, "second half", "first half"),
        "first half", (_TXA, 0), (_RSH, 30), (_JUMP, 0, "end", ""),
        "second half", (_LD_MEM, 1), (_ADD_X, 0), (_MUL, salts[1]), (_RSH, 30), (_ADD, SOCKETS_PER_CLASS // 2),
        (_JUMP, 0, "end", ""),
        "by port", (_LD_MEM, 1), (_ADD_X, 0), (_MUL, salts[1]), (_RSH, 29),
        "end", (_TAX, 0), (_LD_MEM, 0), (_ADD_X, 0), (_RETURN_A, 0),
    ))  # fmt: skip


def _assembled(program: Sequence[Instruction]) -> bytes:
    """Returns the binary form of a program (an array of `struct sock_filter`)."""
    places: dict[str, int] = {}
    instructions: list[tuple[int, int] | tuple[int, int, str, str]] = []
    for item in program:
        if isinstance(item, str):
            places[item] = len(instructions)
        else:
            instructions.append(item)
    out = b""
    for at, instruction in enumerate(instructions):
        code, operand, *labels = instruction
        if code == _JUMP:
            out += struct.pack("=HBBI", code, 0, 0, places[str(labels[0])] - at - 1)
        else:
            out += struct.pack("=HBBI", code, *([places[str(label)] - at - 1 for label in labels] or [0, 0]), operand)
    return out


class SocketGroup:
    """Non-blocking UDP sockets of one address and port, which share its datagrams.

    Linux has `SOCKETS_PER_CLASS` sockets for each `DatagramClass`. Other systems have one socket for all datagrams. If
    Linux does not support programs for groups of sockets (kernels before 4.5, emulation), there is also one socket, and
    a warning is logged.

    Args:
        host: Address to listen on.
        port: UDP port; 0 selects a free port.
        classes: Program that classifies datagrams: `UDP_CLASSES` or `QUIC_CLASSES`.

    Attributes:
        sockets: The sockets, those of `DatagramClass.NEW` first. The first one sends all datagrams.
        local_addresses: Local addresses to which clients have sent; None if the sockets are bound to one address.

    Raises:
        InvalidValueError: If the address cannot be bound.
    """

    def __init__(self, host: str, port: int, classes: Sequence[Instruction]) -> None:
        first = bound_socket(host, port)
        self.sockets = [first]
        self._share_port(host, port, classes)
        self.local_addresses = local_addresses(self.sockets)

    def _share_port(self, host: str, port: int, classes: Sequence[Instruction]) -> None:
        """Adds further sockets for the port of the first one, and the program that distributes datagrams to them.

        The arguments are those of the constructor.
        """
        (first,) = self.sockets
        if sys.platform != "linux":
            return
        try:
            # Not before the first one is bound: another server must not be able to share its port.
            first.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            for _ in range(len(DatagramClass) * SOCKETS_PER_CLASS - 1):
                other = _socket_like(first)
                self.sockets.append(other)
                other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
                other.bind(first.getsockname())
        except OSError as error:
            self.close()
            raise cannot_listen("UDP", host, port, error) from error
        salts = secrets.randbits(32) | 1, secrets.randbits(32) | 1
        try:
            _attach(first, group_program(classes, salts))
        except OSError as error:
            LOG.warning("UDP port %d has one receive buffer, which a flood may fill: %s", self.port, error.strerror)
            for other in self.sockets[1:]:
                other.close()
            self.sockets = [first]
            first.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
            return
        for new in self.sockets[:SOCKETS_PER_CLASS]:
            with suppress(OSError):
                new.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, NEW_BUFFER)

    @property
    def port(self) -> int:
        """UDP port of the sockets."""
        return int(self.sockets[0].getsockname()[1])

    def add_readers(
        self, loop: asyncio.AbstractEventLoop, callback: Callable[[socket.socket, int], None]
    ) -> None:  # fmt: skip
        """Calls a function when datagrams can be read.

        Args:
            loop: Event loop.
            callback: Function that gets the socket, and the maximum number of datagrams to read from it.
        """
        for index, one in enumerate(self.sockets):
            if len(self.sockets) == 1:
                most = sum(TURN_DATAGRAMS.values()) * SOCKETS_PER_CLASS
            else:
                most = TURN_DATAGRAMS[DatagramClass(index // SOCKETS_PER_CLASS)]
            loop.add_reader(one, callback, one, most)

    def remove_readers(self, loop: asyncio.AbstractEventLoop) -> None:
        """Ends the calls of the function given to `add_readers`."""
        for one in self.sockets:
            loop.remove_reader(one)

    def close(self) -> None:
        """Closes all sockets."""
        for one in self.sockets:
            one.close()


def _attach(member: socket.socket, program: bytes) -> None:
    """Attaches a program that chooses among the sockets of a group (SO_REUSEPORT)."""
    memory = ctypes.create_string_buffer(program, len(program))
    value = struct.pack("@HP", len(program) // 8, ctypes.addressof(memory))
    member.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_REUSEPORT_CBPF, value)


def bound_socket(host: str, port: int) -> socket.socket:
    """Returns a non-blocking UDP socket with large buffers, bound to an address and port.

    Raises:
        InvalidValueError: If the address cannot be bound.
    """
    check_port(port)
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, target = addresses[0]
        server = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise cannot_listen("UDP", host, port, error) from error
    try:
        _prepare(server)
        server.bind(target)
    except OSError as error:
        server.close()
        raise cannot_listen("UDP", host, port, error) from error
    return server


def _socket_like(other: socket.socket) -> socket.socket:
    """Returns a non-blocking socket of the same family and type with large buffers."""
    server = socket.socket(other.family, other.type, other.proto)
    _prepare(server)
    return server


def _prepare(server: socket.socket) -> None:
    """Makes a socket non-blocking, with large buffers."""
    server.setblocking(False)
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        with suppress(OSError):
            server.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER)
