"""The datagrams of the transport: their bytes, and the checks that every one passes before it is believed.

Byte 0 is the protocol's version (high 4 bits) and the kind of the datagram; all numbers are little-endian. Every kind
but `DATA` ends with a CRC-32 of all bytes before it; what a `DATA` datagram carries has a checksum of its own. The
tables are in `docs/transport.md`.
"""

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.transport.frames import (
    DIGEST_BYTES,
    MAX_DECLARED,
    MAX_HELD_BYTES,
    MAX_NACKS,
    MAX_NAME,
    MAX_PREVIEW,
    MAX_TIERS,
    TOKEN_BYTES,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Frame,
    Have,
    Hello,
    Parity,
    Refuse,
    Request,
    Side,
    TierHead,
    View,
    Welcome,
)

VERSION = 3
MAX_DATAGRAM = 1200
"""No datagram is larger: every path carries that many bytes (RFC 9000, 14)."""
HELLO_BYTES = MAX_DATAGRAM
"""A greeting is as large as the largest datagram, so that no answer to it is larger."""
HELLO, CHALLENGE, REQUEST, WELCOME, SIDE, DATA, PARITY, FEEDBACK, BYE, REFUSE, END, HAVE, VIEW = range(1, 14)
KINDS = (
    "", "hello", "challenge", "request", "welcome", "side", "data", "parity", "feedback", "bye", "refuse", "end",
    "have", "view",
)  # fmt: skip
TO_SERVER = frozenset((HELLO, REQUEST, FEEDBACK, BYE, HAVE, VIEW))
ON_STREAM = frozenset((REQUEST, WELCOME, REFUSE, SIDE))
"""What travels on the reliable stream where there is one (QUIC), each behind its size (u16)."""

MAX_FOCAL, MAX_FAR, TURNED = 1e6, 1e12, 0.01
"""Of a view: pixels, world units, and how far from a rotation its matrix may be."""

_CRC = struct.Struct("<I")
_HELLO = struct.Struct("<BQB")
_CHALLENGE = struct.Struct(f"<BQ{TOKEN_BYTES}s")
_REQUEST = struct.Struct(f"<BQ{TOKEN_BYTES}sB")
_WELCOME = struct.Struct(f"<BQIIQ{DIGEST_BYTES}sHIHIB")
_TIER = struct.Struct("<IHH")
_SIZE = struct.Struct("<H")
_SIDE = struct.Struct("<BIIHI")
_DATA = struct.Struct("<BIII")
_PARITY = struct.Struct("<BIIHI")
_FEEDBACK = struct.Struct("<BIIIIIH")
_BYE = struct.Struct("<BI")
_VIEW = struct.Struct("<BIIIHH13f")
_REFUSE = struct.Struct("<BQB")
_END = struct.Struct("<BII")
_HAVE = struct.Struct("<BQIBI")

SIDE_OVERHEAD = _SIDE.size + _CRC.size
DATA_OVERHEAD = _DATA.size
PARITY_OVERHEAD = _PARITY.size + _CRC.size


def encode_data(session: int, sequence: int, place: int, packet: bytes) -> bytes:
    """Writes a `DATA` datagram."""
    return _DATA.pack(VERSION << 4 | DATA, session, sequence, place) + packet


def encode_symbol(kind: int, session: int, sequence: int, group: int, symbol: int, payload: bytes) -> bytes:
    """Writes a `SIDE` (group: segment) or `PARITY` datagram."""
    return _closed(_SIDE.pack(VERSION << 4 | kind, session, sequence, group, symbol) + payload)


def encode(frame: Frame) -> bytes:
    """Writes a datagram."""
    match frame:
        case Data():
            return encode_data(*frame)
        case Side():
            return encode_symbol(SIDE, *frame)
        case Parity():
            return encode_symbol(PARITY, *frame)
        case Hello():
            body = _HELLO.pack(VERSION << 4 | HELLO, frame.nonce, len(frame.name.encode())) + frame.name.encode()
            return _closed(body.ljust(HELLO_BYTES - _CRC.size, b"\0"))
        case Challenge():
            return _closed(_CHALLENGE.pack(VERSION << 4 | CHALLENGE, *frame))
        case Request():
            name = frame.name.encode()
            return _closed(_REQUEST.pack(VERSION << 4 | REQUEST, frame.nonce, frame.token, len(name)) + name)
        case Welcome():
            head = _WELCOME.pack(VERSION << 4 | WELCOME, *frame[:-2], len(frame.tiers))
            tiers = b"".join(_TIER.pack(*tier) for tier in frame.tiers)
            return _closed(head + tiers + _SIZE.pack(len(frame.preview)) + frame.preview)
        case Feedback():
            head = _FEEDBACK.pack(VERSION << 4 | FEEDBACK, *frame[:-1], len(frame.nacks))
            return _closed(head + struct.pack(f"<{len(frame.nacks)}I", *frame.nacks))
        case Bye():
            return _closed(_BYE.pack(VERSION << 4 | BYE, *frame))
        case View():
            return _closed(_VIEW.pack(VERSION << 4 | VIEW, *frame[:-1], *frame.viewmat))
        case Refuse():
            return _closed(_REFUSE.pack(VERSION << 4 | REFUSE, *frame))
        case End():
            return _closed(_END.pack(VERSION << 4 | END, *frame))
        case Have():
            return _closed(_HAVE.pack(VERSION << 4 | HAVE, *frame[:-1]) + frame.held)


def kind_of(data: bytes) -> int:
    """Kind of a datagram, not checked further; 0 if it is none of ours."""
    kind = data[0] & 15 if data else 0
    return kind if data and data[0] >> 4 == VERSION and 1 <= kind <= VIEW else 0


def decode(data: bytes) -> Frame:
    """Reads a datagram, believing nothing before its size and checksum hold.

    Raises:
        UnsupportedVersionError: If it is of another version of the protocol.
        BitstreamError: If it is cut, damaged, or something else.
    """
    if not data or len(data) > MAX_DATAGRAM:
        raise BitstreamError(f"a datagram of {len(data)} bytes is none of ours")
    kind = kind_of(data)
    if not kind:
        if data[0] >> 4 != VERSION:
            raise UnsupportedVersionError(f"a datagram of protocol version {data[0] >> 4}, not {VERSION}")
        raise BitstreamError(f"a datagram of unknown kind {data[0] & 15}")
    if kind == DATA:
        if len(data) <= _DATA.size:
            raise BitstreamError("a data datagram without a packet")
        _, session, sequence, place = _DATA.unpack_from(data)
        return Data(session, sequence, place, data[_DATA.size :])
    if len(data) < _CRC.size + 1 or zlib.crc32(data[: -_CRC.size]) != _CRC.unpack_from(data, len(data) - 4)[0]:
        raise BitstreamError(f"a {KINDS[kind]} datagram whose checksum does not match")
    try:
        return _DECODERS[kind](data[: -_CRC.size])
    except struct.error as error:
        raise BitstreamError(f"a {KINDS[kind]} datagram of {len(data)} bytes is cut") from error


def _closed(body: bytes) -> bytes:
    return body + _CRC.pack(zlib.crc32(body))


def _exactly(layout: struct.Struct, body: bytes) -> tuple[Any, ...]:
    if len(body) != layout.size:
        raise BitstreamError(f"a datagram of {len(body)} bytes where {layout.size} are needed")
    return layout.unpack(body)[1:]


def _name(body: bytes, start: int, size: int) -> str:
    try:
        name = body[start : start + size].decode()
    except UnicodeDecodeError as error:
        raise BitstreamError("a stream's name is not UTF-8") from error
    if size > MAX_NAME or len(body) < start + size or not (name.isprintable()):
        raise BitstreamError("a stream's name is too long, cut, or not printable")
    return name


def _hello(body: bytes) -> Hello:
    if len(body) != HELLO_BYTES - _CRC.size:
        raise BitstreamError(f"a greeting of {len(body)} bytes is not padded as it must be")
    _, nonce, size = _HELLO.unpack_from(body)
    return Hello(nonce, _name(body, _HELLO.size, size))


def _request(body: bytes) -> Request:
    _, nonce, token, size = _REQUEST.unpack_from(body)
    if len(body) != _REQUEST.size + size:
        raise BitstreamError("a request whose size contradicts itself")
    return Request(nonce, token, _name(body, _REQUEST.size, size))


def _welcome(body: bytes) -> Welcome:
    *fields, count = _WELCOME.unpack_from(body)
    end = _WELCOME.size + count * _TIER.size
    (size,) = _SIZE.unpack_from(body, end)
    declared = count * _TIER.size + size
    if (
        not 1 <= count <= MAX_TIERS
        or size > MAX_PREVIEW
        or declared > MAX_DECLARED
        or len(body) != end + _SIZE.size + size
    ):
        raise BitstreamError("a welcome whose size contradicts itself")
    tiers = tuple(TierHead(*tier) for tier in _TIER.iter_unpack(body[_WELCOME.size : end]))
    return Welcome._make([*fields[1:], tiers, body[end + _SIZE.size :]])


def _feedback(body: bytes) -> Feedback:
    *fields, count = _FEEDBACK.unpack_from(body)
    if count > MAX_NACKS or len(body) != _FEEDBACK.size + 4 * count:
        raise BitstreamError("a feedback whose size contradicts itself")
    return Feedback._make([*fields[1:], struct.unpack_from(f"<{count}I", body, _FEEDBACK.size)])


def _have(body: bytes) -> Have:
    _, nonce, stream_id, head, first = _HAVE.unpack_from(body)
    held = body[_HAVE.size :]
    if head > 1 or first % 8 or len(held) > MAX_HELD_BYTES:
        raise BitstreamError("a datagram of what a client has that contradicts itself")
    return Have(nonce, stream_id, head, first, held)


def _symbol(body: bytes) -> tuple[Any, ...]:
    fields = _SIDE.unpack_from(body)[1:]
    if len(body) == _SIDE.size:
        raise BitstreamError("a symbol without content")
    return (*fields, body[_SIDE.size :])


def _view(body: bytes) -> View:
    *fields, focal = _exactly(_VIEW, body)[:6]
    rows = _VIEW.unpack(body)[7:]
    turn = np.array(rows, dtype=np.float64).reshape(3, 4)
    fine = np.isfinite(turn).all() and 0 < focal < MAX_FOCAL and min(fields[2:]) > 0 and np.abs(turn).max() < MAX_FAR
    if not fine or np.abs(turn[:, :3] @ turn[:, :3].T - np.eye(3)).max() > TURNED:
        raise BitstreamError("a view from nowhere")
    return View._make([*fields, focal, rows])


_DECODERS: dict[int, Callable[[bytes], Frame]] = {
    HELLO: _hello,
    CHALLENGE: lambda body: Challenge(*_exactly(_CHALLENGE, body)),
    REQUEST: _request,
    WELCOME: _welcome,
    SIDE: lambda body: Side(*_symbol(body)),
    PARITY: lambda body: Parity(*_symbol(body)),
    FEEDBACK: _feedback,
    BYE: lambda body: Bye(*_exactly(_BYE, body)),
    REFUSE: lambda body: Refuse(*_exactly(_REFUSE, body)),
    VIEW: _view,
    END: lambda body: End(*_exactly(_END, body)),
    HAVE: _have,
}
