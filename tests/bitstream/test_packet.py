import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatwire.bitstream import HEADER_BYTES, PacketId, make_packet, packet_from_bytes
from splatwire.errors import (
    BitstreamError,
    CorruptPacketError,
    ForeignPacketError,
    InvalidValueError,
    TruncatedStreamError,
    UnsupportedVersionError,
)

PACKET = make_packet(PacketId(70_000, 5), 375, bytes(range(100)), 77)

names = st.builds(PacketId, st.integers(0, (1 << 24) - 1), st.integers(0, (1 << 14) - 1)) | st.builds(
    PacketId, st.integers(0, (1 << 24) - 1), st.integers(0, 255), st.integers(1, 66)
)


@settings(deadline=None)
@given(names, st.integers(1, 65535), st.binary(max_size=60), st.integers(0, (1 << 32) - 1))
def test_packet_round_trips(packet_id, num_elements, payload, stream_id):
    packet = make_packet(packet_id, num_elements, payload, stream_id)
    assert (packet.id, packet.num_elements, packet.payload) == (packet_id, num_elements, payload)
    assert len(packet.data) == packet.num_bytes == HEADER_BYTES + len(payload)
    assert packet_from_bytes(packet.data, stream_id) == packet
    assert packet_from_bytes(memoryview(packet.data), None) == packet


def test_header_is_at_most_16_bytes():
    assert make_packet(PacketId(0, 0), 1, b"").num_bytes <= 16


def test_every_flipped_bit_is_detected():
    data = PACKET.data
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(BitstreamError):
            packet_from_bytes(bytes(damaged), 77)


def test_every_truncation_is_detected():
    data = PACKET.data
    for size in range(len(data)):
        with pytest.raises(TruncatedStreamError if size < HEADER_BYTES else CorruptPacketError):
            packet_from_bytes(data[:size], 77)


def test_foreign_and_newer_packets_are_reported():
    data = PACKET.data
    with pytest.raises(ForeignPacketError, match=r"pak_lane5_s70000\.pak .* stream 0000004d, not 0000004e"):
        packet_from_bytes(data, 78)
    with pytest.raises(UnsupportedVersionError, match="version 2"):
        packet_from_bytes(b"\x02" + data[1:], 77)


@pytest.mark.parametrize(
    "arguments",
    [
        (PacketId(1 << 24, 0), 1, b""),
        (PacketId(0, 1 << 14), 1, b""),
        (PacketId(0, 0), 0, b""),
        (PacketId(0, 0), 65536, b""),
    ],
)
def test_packet_beyond_header_limits_is_not_constructed(arguments):
    with pytest.raises(InvalidValueError):
        make_packet(*arguments)


def test_fuzz_never_accepts_a_wrong_packet():
    """12000 packets with flipped bits, overwritten, cut, grown and shuffled bytes."""
    rng = np.random.default_rng(0)
    for _ in range(12_000):
        payload = rng.bytes(int(rng.integers(0, 60)))
        packet = make_packet(
            PacketId(int(rng.integers(50)), int(rng.integers(8))), int(rng.integers(1, 500)), payload, 99
        )
        data = packet.data
        damaged = damage(data, rng)
        try:
            found = packet_from_bytes(damaged, 99)
        except BitstreamError:
            assert damaged != data
        else:
            assert damaged == data
            assert found == packet


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    out, at = bytearray(data), int(rng.integers(len(data)))
    match int(rng.integers(6)):
        case 0:
            out[at] ^= 1 << int(rng.integers(8))
        case 1:
            del out[at:]
        case 2:
            out += rng.bytes(int(rng.integers(1, 9)))
        case 3:
            out[at : at + 8] = rng.bytes(len(out[at : at + 8]))
        case 4:
            out = bytearray(rng.bytes(len(data)))
        case 5:
            del out[at : at + 1 + int(rng.integers(8))]
    return bytes(out)


def test_every_packet_field_round_trips():
    bytes_of_parts = set()
    for part in range(67):
        lane = 255 if part else (1 << 14) - 1
        packet = make_packet(PacketId(5, lane, part), 3, b"x", 9)
        data = packet.data
        assert packet_from_bytes(data, 9) == packet
        bytes_of_parts.add(data[5] & 3 if part == 0 else data[5])
    assert len(bytes_of_parts) == 67
    for bad in (PacketId(0, 256, 1), PacketId(0, 0, 67)):
        with pytest.raises(InvalidValueError):
            make_packet(bad, 1, b"")


def test_unknown_attribute_part_is_damage():
    data = bytearray(make_packet(PacketId(0, 0, 66), 1, b"x", 9).data)
    for byte in range(256):
        data[5] = byte
        data[12:16] = zlib.crc32(data[16:], zlib.crc32(data[:12])).to_bytes(4, "little")
        if byte & 3 == 0 or byte <= 87:
            assert packet_from_bytes(bytes(data), 9).id.part < 67
        else:
            with pytest.raises(CorruptPacketError, match="makes no sense"):
                packet_from_bytes(bytes(data), 9)
