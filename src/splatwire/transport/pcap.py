"""Captures of UDP datagrams in the classic libpcap format of tcpdump and Wireshark."""

import ipaddress
import struct
from collections.abc import Callable
from typing import Any

MAGIC = 0xA1B2C3D4
LINKTYPE_RAW = 101
"""Link type of raw IP: a record starts with an IPv4 or IPv6 header; its first 4 bits are the version."""
SNAP_BYTES = 65_535
HOP_LIMIT = 64
UDP = 17

_FILE = struct.Struct("<IHHiIII")
_RECORD = struct.Struct("<IIII")
_UDP = struct.Struct(">HHHH")
_IPV4 = struct.Struct(">BBHHHBBH4s4s")
_IPV6 = struct.Struct(">IHBB16s16s")

Endpoint = tuple[str, int]
"""Numeric IP address and UDP port."""


class Capture:
    """Writer of a pcap file with UDP datagrams.

    Args:
        write: Called with successive pieces of the file, bytes.
    """

    def __init__(self, write: Callable[[bytes], Any]) -> None:
        self._write = write
        self.num_datagrams = 0
        write(_FILE.pack(MAGIC, 2, 4, 0, 0, SNAP_BYTES, LINKTYPE_RAW))

    def add(self, source: Endpoint, target: Endpoint, payload: bytes, seconds: float) -> None:
        """Appends a UDP datagram to the pcap file.

        Args:
            source: Source address and port.
            target: Destination address and port.
            payload: UDP payload.
            seconds: Time of capture, seconds since 1970.
        """
        data = ip_datagram(source, target, payload)
        micros = int(seconds * 1e6)
        self._write(_RECORD.pack(micros // 1_000_000, micros % 1_000_000, len(data), len(data)) + data)
        self.num_datagrams += 1


def ip_datagram(source: Endpoint, target: Endpoint, payload: bytes) -> bytes:
    """Returns a UDP datagram with its IP header and valid checksums.

    Args:
        source: Source address and port.
        target: Destination address and port.
        payload: UDP payload.
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
    """Returns the Internet checksum (RFC 1071): the complement of the ones' complement sum of all 16-bit words."""
    # 2**16 is 1 modulo 65535, so the bytes as one integer leave the same remainder as the sum of the 16-bit words.
    rest = int.from_bytes(data + b"\0" * (len(data) % 2), "big") % 0xFFFF
    return 0xFFFF - (rest or (0xFFFF if any(data) else 0))


def _packed(host: str) -> bytes:
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        return address.ipv4_mapped.packed
    return address.packed
