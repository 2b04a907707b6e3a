import contextlib
import random
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.transport.protocol import wire
from splatwire.transport.protocol.messages import (
    MAX_HELD_BYTES,
    MAX_NACKS,
    MAX_PARITY_RANGES,
    MAX_PREVIEW,
    OTHER_TRANSPORT,
    OTHER_VERSION,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Have,
    Hello,
    InitSymbol,
    Parity,
    ParityRange,
    Refuse,
    Request,
    ViewUpdate,
    Welcome,
)

MAX_TIERS = 10
"""Fits with the largest preview."""
u16, u32, u64 = (st.integers(0, (1 << bits) - 1) for bits in (16, 32, 64))
flag, digests = st.booleans(), st.binary(min_size=32, max_size=32)
names = st.text("abc-é.", max_size=20)
tiers = st.lists(st.builds(ParityRange, u32, u16, u16), min_size=1, max_size=MAX_TIERS).map(tuple)
many = st.lists(st.builds(ParityRange, u32, u16, u16), min_size=1, max_size=MAX_PARITY_RANGES).map(tuple)
previews = st.binary(max_size=MAX_PREVIEW)
sides = st.integers(1, (1 << 16) - 1)
asked = st.lists(u32, max_size=MAX_NACKS // 2).map(tuple)
places = st.tuples(*[st.floats(-1e6, 1e6, width=32)] * 3).map(lambda p: (0, -1, 0, p[0], 1, 0, 0, p[1], 0, 0, 1, p[2]))
messages = st.one_of(
    st.builds(Hello, u64, names),
    st.builds(Challenge, u64, st.binary(min_size=16, max_size=16)),
    st.builds(Request, u64, st.binary(min_size=16, max_size=16), names, st.text("aZ09-_.", max_size=1024)),
    st.builds(Welcome, u64, u32, u32, u64, digests, u16, u32, u16, u32, tiers, previews, flag, flag),
    st.builds(Welcome, u64, u32, u32, u64, digests, u16, u32, u16, u32, many, st.just(b""), flag),
    st.builds(InitSymbol, u32, u32, u16, u32, st.binary(min_size=1, max_size=1100)),
    st.builds(Data, u32, u32, u32, st.binary(min_size=1, max_size=1150)),
    st.builds(Parity, u32, u32, u16, u32, st.binary(min_size=1, max_size=1152)),
    st.builds(Feedback, u32, u32, u32, u32, u32, asked, asked),
    st.builds(Bye, u32),
    st.builds(Refuse, u64, st.integers(0, 255)),
    st.builds(End, u32, u32),
    st.builds(
        Have,
        u64,
        u32,
        st.integers(0, 1),
        st.integers(0, 1 << 20).map(lambda n: 8 * n),
        st.binary(max_size=MAX_HELD_BYTES),
    ),
    st.builds(ViewUpdate, u32, u32, st.integers(1, (1 << 32) - 1), sides, sides, st.floats(1, 1000, width=32), places),
)


@settings(deadline=None)  # independent of machine load
@given(messages)
def test_messages_round_trip_within_the_minimum_path_mtu(message):
    data = wire.encode(message)
    assert len(data) <= wire.MAX_DATAGRAM
    assert wire.decode(data) == message


@settings(deadline=None)  # independent of machine load
@given(messages, st.data())
def test_every_flipped_bit_and_truncation_is_detected(message, data):
    """The checksum of the inner packet protects `DATA`, so it is left out here."""
    if isinstance(message, Data):
        return
    good = wire.encode(message)
    bit = data.draw(st.integers(8, 8 * len(good) - 1))
    damaged = bytearray(good)
    damaged[bit // 8] ^= 1 << bit % 8
    cut = data.draw(st.integers(0, len(good) - 1))
    for bad in (bytes(damaged), good[:cut], good + b"\0"):
        with pytest.raises(BitstreamError):
            wire.decode(bad)


def test_wire_bytes_are_pinned():
    """A change of these bytes needs a new protocol version."""
    assert wire.encode(Data(1, 2, 3, b"packet")).hex() == "46010000000200000003000000" + b"packet".hex()
    assert wire.encode(Bye(0x01020304)).hex() == "49040302013fb6d45b"
    assert wire.encode(InitSymbol(1, 2, 3, 4, b"symbol")).hex() == "45010000000200000003000400000073796d626f6caaf47ef9"
    assert wire.encode(Have(1, 2, 1, 8, b"\x05")).hex() == "4c010000000000000002000000010800000005173f2817"
    feedback = wire.encode(Feedback(1, 2, 3, 4, 5, (6, 7), (8,)))
    assert feedback.hex() == "480100000002000000030000000400000005000000020001000600000007000000080000004b76f37c"
    welcome = wire.encode(Welcome(1, 2, 3, 4, bytes(32), 5, 6, 7, 8, (ParityRange(9, 10, 11),), b"scene", True, True))
    head = "44" + "0100000000000000" + "02000000" + "03000000" + "0400000000000000" + "00" * 32
    rest = "0500" + "06000000" + "0700" + "08000000" + "03" + "01" + "090000000a000b00" + "0500" + b"scene".hex()
    assert welcome.hex() == head + rest + "82668204"


def test_welcome_contains_the_preview_length():
    tiers, most = (ParityRange(1, 0, 0),) * MAX_TIERS, bytes(range(256)) * (MAX_PREVIEW // 256)
    largest = wire.encode(Welcome(1, 2, 3, 4, bytes(32), 5, 6, 7, 8, tiers, most))
    assert len(largest) == 1181 <= wire.MAX_DATAGRAM
    assert wire.decode(largest).preview == most
    plain = Welcome(1, 2, 3, 4, bytes(32), 5, 6, 7, 8, tiers[:1], b"preview")
    assert wire.decode(wire.encode(plain._replace(preview=b""))).preview == b""
    body = wire.encode(plain)[:-4]
    for size, content in ((0, b"preview"), (6, b"preview"), (8, b"preview"), (65_535, b""), (1025, bytes(1025))):
        bad = body[:-9] + size.to_bytes(2, "little") + content
        with pytest.raises(BitstreamError, match="inconsistent size"):
            wire.decode(bad + zlib.crc32(bad).to_bytes(4, "little"))


def test_first_client_datagram_is_at_least_as_large_as_any_answer():
    assert len(wire.encode(Hello(1, ""))) == wire.MAX_DATAGRAM
    assert len(wire.encode(Challenge(1, bytes(16)))) < 40


def test_other_versions_are_reported():
    with pytest.raises(UnsupportedVersionError, match="protocol version 1"):
        wire.decode(b"\x11" + bytes(30))
    with pytest.raises(UnsupportedVersionError, match="protocol version 3, not 4"):
        wire.decode(b"\x34" + bytes(78))


def sealed(body: bytes) -> bytes:
    return body + zlib.crc32(body).to_bytes(4, "little")


def test_refusal_of_another_version_is_readable_by_that_version():
    for old in (1, 2, 3):
        hello = sealed(bytes([old << 4 | wire.HELLO]) + (77).to_bytes(8, "little") + bytes(20))
        answer = wire.refuse_other_version(hello)
        body = bytes([old << 4 | wire.REFUSE]) + (77).to_bytes(8, "little") + bytes([OTHER_VERSION])
        assert answer == sealed(body)
        assert wire.refuse_other_version(hello[:-1]) is None
        assert wire.refuse_other_version(sealed(hello[: len(answer) - 4])) is None  # no amplification
    assert wire.refuse_other_version(wire.encode(Hello(77, ""))) is None
    assert wire.refuse_other_version(b"\x36" + bytes(40)) is None


def test_unknown_flags_of_a_welcome_are_refused():
    body = bytearray(wire.encode(Welcome(1, 2, 3, 4, bytes(32), 5, 6, 7, 8, (ParityRange(9, 0, 0),)))[:-4])
    body[69] = 4
    with pytest.raises(BitstreamError, match="unknown flags 0x4"):
        wire.decode(bytes(body) + zlib.crc32(body).to_bytes(4, "little"))


def test_names_are_printable_and_short():
    for name in ("a" * 65, "a\nb", "\x1b[31m"):
        with pytest.raises(BitstreamError):
            wire.decode(wire.encode(Hello(1, name)))


def test_random_bytes_raise_at_most_one_error_type():
    rng = np.random.default_rng(0)
    accepted = 0
    for _ in range(5000):
        data = bytes([wire.VERSION << 4 | int(rng.integers(16))]) + rng.bytes(int(rng.integers(0, 1300)))
        with contextlib.suppress(BitstreamError):
            accepted += not isinstance(wire.decode(data), Data)
    assert accepted == 0


def test_datagrams_of_the_other_transport_are_refused_with_the_nonce_of_the_client():
    rng = random.Random(4)
    initial = b"\xc3\0\0\0\1\x08" + rng.randbytes(8) + b"\x08" + (77).to_bytes(8, "little") + rng.randbytes(1177)
    assert wire.decode(wire.refuse_other_transport(initial)) == Refuse(77, OTHER_TRANSPORT)
    assert wire.decode(wire.refuse_other_transport(wire.encode(Hello(78, "scene")))) == Refuse(78, OTHER_TRANSPORT)
    assert wire.refuse_other_transport(initial[:-1]) is None
    assert wire.refuse_other_transport(initial.replace(b"\0\0\0\1", b"\0\0\0\2")) is None
    assert wire.refuse_other_transport(b"\x41" + wire.encode(Hello(78, "scene"))[2:] + b"\0") is None
    for _ in range(2000):
        data = bytearray(initial)
        data[rng.randrange(40)] = rng.randrange(256)
        wire.refuse_other_transport(bytes(data))
        assert wire.refuse_other_transport(rng.randbytes(rng.randrange(40))) is None
