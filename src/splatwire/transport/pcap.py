"""Captures of UDP datagrams in the classic libpcap format, which tcpdump and Wireshark read."""

import ipaddress
import struct
from collections.abc import Callable
from typing import Any

MAGIC = 0xA1B2C3D4
LINKTYPE_RAW = 101
"""A record begins with an IPv4 or IPv6 header; which one, its first 4 bits say."""
SNAP_BYTES = 65_535
HOP_LIMIT = 64
UDP = 17

_FILE = struct.Struct("<IHHiIII")
_RECORD = struct.Struct("<IIII")
_UDP = struct.Struct(">HHHH")
_IPV4 = struct.Struct(">BBHHHBBH4s4s")
_IPV6 = struct.Struct(">IHBB16s16s")

Endpoint = tuple[str, int]
"""Numeric address and port."""


class Capture:
    """Writes a capture; what happens outside of it (who sent what, when) is told to it.

    Args:
        write: Called with bytes for the file, one piece after another.
    """

    def __init__(self, write: Callable[[bytes], Any]) -> None:
        self._write = write
        self.num_datagrams = 0
        write(_FILE.pack(MAGIC, 2, 4, 0, 0, SNAP_BYTES, LINKTYPE_RAW))

    def add(self, source: Endpoint, target: Endpoint, payload: bytes, seconds: float) -> None:
        """Takes a UDP datagram.

        Args:
            source: Where it is from.
            target: Where it goes.
            payload: Its content.
            seconds: When, seconds since 1970.
        """
        data = ip_datagram(source, target, payload)
        micros = int(seconds * 1e6)
        self._write(_RECORD.pack(micros // 1_000_000, micros % 1_000_000, len(data), len(data)) + data)
        self.num_datagrams += 1


def ip_datagram(source: Endpoint, target: Endpoint, payload: bytes) -> bytes:
    """A UDP datagram with its IP header, both checksums right.

    Args:
        source: Where it is from; IPv4 addresses within IPv6 (`::ffff:1.2.3.4`) count as IPv4.
        target: Where it goes.
        payload: Its content.
    """
    start, stop = _packed(source[0]), _packed(target[0])
    if len(start) != len(stop):
        start, stop = (b"\0" * 10 + b"\xff\xff" + a if len(a) == 4 else a for a in (start, stop))
    size = _UDP.size + len(payload)
    pseudo = start + stop + struct.pack(">II", size, UDP)
    udp = _UDP.pack(source[1], target[1], size, 0) + payload
    udp = _UDP.pack(source[1], target[1], size, checksum(pseudo + udp) or 0xFFFF) + payload
    if len(start) == 16:
        return _IPV6.pack(6 << 28, size, UDP, HOP_LIMIT, start, stop) + udp
    header = _IPV4.pack(0x45, 0, _IPV4.size + size, 0, 0x4000, HOP_LIMIT, UDP, 0, start, stop)
    return header[:10] + checksum(header).to_bytes(2, "big") + header[12:] + udp


def checksum(data: bytes) -> int:
    """The internet checksum (RFC 1071): complement of the sum of all 16-bit words in ones' complement arithmetic."""
    # 2**16 is 1 modulo 65535: the number that the bytes spell leaves the same rest as the sum of its 16-bit words.
    rest = int.from_bytes(data + b"\0" * (len(data) % 2), "big") % 0xFFFF
    return 0xFFFF - (rest or (0xFFFF if any(data) else 0))


def _packed(host: str) -> bytes:
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        return address.ipv4_mapped.packed
    return address.packed
