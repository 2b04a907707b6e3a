"""Binary encoding and decoding of the wire protocol's messages, with validation.

The format is described in `docs/wire.md`.
"""

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.transport.protocol.messages import (
    DIGEST_BYTES,
    MAX_DECLARED,
    MAX_HELD_BYTES,
    MAX_NACKS,
    MAX_NAME,
    MAX_PARITY_RANGES,
    MAX_PREVIEW,
    MAX_SCENE_TOKEN,
    OTHER_TRANSPORT,
    OTHER_VERSION,
    TOKEN_BYTES,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Have,
    Hello,
    InitSymbol,
    Message,
    Parity,
    ParityRange,
    Refuse,
    Request,
    ViewUpdate,
    Welcome,
)

VERSION = 4
MAX_DATAGRAM = 1200
"""Maximum size of a datagram in bytes; fits every QUIC path (RFC 9000, 14)."""
SMALL_MTU = f"the path carries no datagrams of {MAX_DATAGRAM:,} bytes (its MTU is below {MAX_DATAGRAM + 28:,})"
"""Error message if the path delivers no datagrams of the maximum size."""
HELLO_BYTES = MAX_DATAGRAM
"""Size in bytes of a client's first datagram: the maximum, so that no response is larger (anti-amplification)."""
HELLO, CHALLENGE, REQUEST, WELCOME, INIT_SYMBOL, DATA, PARITY, FEEDBACK, BYE, REFUSE = range(1, 11)
END, HAVE, VIEW_UPDATE = range(11, 14)
MESSAGE_KINDS = (
    "", "hello", "challenge", "request", "welcome", "init symbol", "data", "parity", "feedback", "bye", "refuse", "end",
    "have", "view update",
)  # fmt: skip
TO_SERVER = frozenset((HELLO, REQUEST, FEEDBACK, BYE, HAVE, VIEW_UPDATE))
STREAM_MESSAGES = frozenset((REQUEST, WELCOME, REFUSE, INIT_SYMBOL))
"""Kinds of messages that are sent on the reliable stream if there is one (QUIC), with a u16 size prefix.
Pages also send `HAVE` there."""

MAX_FOCAL, MAX_COORDINATE, MAX_ROTATION_ERROR = 1e6, 1e12, 0.01
"""Maxima that a valid viewpoint must not exceed: focal length in pixels, coordinates in scene units, and deviation of
its matrix from a rotation.
"""

LIVE, VIEW_DEPENDENT = 1, 2
"""Flags of a welcome: live stream; view-dependent sending order."""
_QUIC_VERSIONS = (b"\x00\x00\x00\x01", b"\x6b\x33\x43\xcf")
_CRC = struct.Struct("<I")
_HELLO = struct.Struct("<BQB")
_CHALLENGE = struct.Struct(f"<BQ{TOKEN_BYTES}s")
_REQUEST = struct.Struct(f"<BQ{TOKEN_BYTES}sB")
_WELCOME = struct.Struct(f"<BQIIQ{DIGEST_BYTES}sHIHIBB")
_PARITY_RANGE = struct.Struct("<IHH")
_SIZE = struct.Struct("<H")
_INIT_SYMBOL = struct.Struct("<BIIHI")
_DATA = struct.Struct("<BIII")
_PARITY = struct.Struct("<BIIHI")
_FEEDBACK = struct.Struct("<BIIIIIHH")
_BYE = struct.Struct("<BI")
_VIEW_UPDATE = struct.Struct("<BIIIHH13f")
_REFUSE = struct.Struct("<BQB")
_END = struct.Struct("<BII")
_HAVE = struct.Struct("<BQIBI")

INIT_SYMBOL_OVERHEAD = _INIT_SYMBOL.size + _CRC.size
DATA_OVERHEAD = _DATA.size
PARITY_OVERHEAD = _PARITY.size + _CRC.size


def encode_data(session: int, sequence: int, packet_index: int, packet: bytes) -> bytes:
    """Encodes a message with a packet of the stream.

    Args:
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
        packet_index: Index of the packet in sending order.
        packet: Bytes of the packet.
    """
    return _DATA.pack(VERSION << 4 | DATA, session, sequence, packet_index) + packet


def encode_symbol(kind: int, session: int, sequence: int, group: int, symbol: int, payload: bytes) -> bytes:
    """Encodes a message with a symbol of the erasure code.

    Args:
        kind: `INIT_SYMBOL` for a symbol of the init segment, `PARITY` for a repair symbol of packets.
        session: Id of the transfer.
        sequence: Sequence number of the datagram.
        group: For `INIT_SYMBOL`: index of the source block (part of the init segment that is coded separately). For
            `PARITY`: index of the parity group.
        symbol: Index of the symbol in the source block or parity group.
        payload: Bytes of the symbol.
    """
    return _with_checksum(_INIT_SYMBOL.pack(VERSION << 4 | kind, session, sequence, group, symbol) + payload)


def encode(message: Message) -> bytes:
    """Encodes a message of any kind."""
    match message:
        case Data():
            return encode_data(*message)
        case InitSymbol():
            return encode_symbol(INIT_SYMBOL, *message)
        case Parity():
            return encode_symbol(PARITY, *message)
        case Hello():
            body = _HELLO.pack(VERSION << 4 | HELLO, message.nonce, len(message.name.encode())) + message.name.encode()
            return _with_checksum(body.ljust(HELLO_BYTES - _CRC.size, b"\0"))
        case Challenge():
            return _with_checksum(_CHALLENGE.pack(VERSION << 4 | CHALLENGE, *message))
        case Request():
            name = message.name.encode()
            prefix = _REQUEST.pack(VERSION << 4 | REQUEST, message.nonce, message.token, len(name))
            return _with_checksum(prefix + name + message.scene_token.encode())
        case Welcome():
            flags = LIVE * message.is_live | VIEW_DEPENDENT * message.view_dependent
            prefix = _WELCOME.pack(VERSION << 4 | WELCOME, *message[:9], flags, len(message.parity_ranges))
            ranges = b"".join(_PARITY_RANGE.pack(*parity_range) for parity_range in message.parity_ranges)
            return _with_checksum(prefix + ranges + _SIZE.pack(len(message.preview)) + message.preview)
        case Feedback():
            requested = (*message.nacks, *message.lost_sequences)
            prefix = _FEEDBACK.pack(
                VERSION << 4 | FEEDBACK, *message[:5], len(message.nacks), len(message.lost_sequences)
            )
            return _with_checksum(prefix + struct.pack(f"<{len(requested)}I", *requested))
        case Bye():
            return _with_checksum(_BYE.pack(VERSION << 4 | BYE, *message))
        case ViewUpdate():
            return _with_checksum(_VIEW_UPDATE.pack(VERSION << 4 | VIEW_UPDATE, *message[:-1], *message.viewmat))
        case Refuse():
            return _with_checksum(_REFUSE.pack(VERSION << 4 | REFUSE, *message))
        case End():
            return _with_checksum(_END.pack(VERSION << 4 | END, *message))
        case Have():
            return _with_checksum(_HAVE.pack(VERSION << 4 | HAVE, *message[:-1]) + message.held)


def message_kind(data: bytes) -> int:
    """Returns the kind of a message without further checks, or 0 for bytes of another protocol."""
    kind = data[0] & 15 if data else 0
    return kind if data and data[0] >> 4 == VERSION and 1 <= kind <= VIEW_UPDATE else 0


def refuse_other_version(data: bytes) -> bytes | None:
    """Returns the server's refusal of a client's request, encoded in the protocol version that the client uses.

    Servers refuse all versions but their own.

    Args:
        data: Datagram of a client.

    Returns:
        The refusal; None if the datagram is not a valid request of another version.
    """
    if len(data) <= _REFUSE.size + _CRC.size or data[0] >> 4 == VERSION or data[0] & 15 not in (HELLO, REQUEST):
        return None
    if not _is_intact(data):
        return None
    (nonce,) = struct.unpack_from("<Q", data, 1)
    return _with_checksum(_REFUSE.pack(data[0] & 0xF0 | REFUSE, nonce, OTHER_VERSION))


def refuse_other_transport(data: bytes) -> bytes | None:
    """Returns the refusal of a client that uses plain UDP at a QUIC port, or QUIC at a port for plain UDP.

    Args:
        data: First datagram of a client.

    Returns:
        The encoded refusal; None if the datagram starts no connection. The nonce of the refusal identifies the
        connection attempt. For plain UDP, it is the nonce of the client's datagram. For QUIC, it consists of the first
        8 bytes of the client's (source) connection id.
    """
    if message_kind(data) in (HELLO, REQUEST):
        if len(data) <= _REFUSE.size + _CRC.size or not _is_intact(data):
            return None
        return encode(Refuse(struct.unpack_from("<Q", data, 1)[0], OTHER_TRANSPORT))
    if len(data) < MAX_DATAGRAM or data[0] & 0xC0 != 0xC0 or data[1:5] not in _QUIC_VERSIONS:
        return None
    at = 6 + data[5]
    return encode(Refuse(int.from_bytes(data[at + 1 : at + 1 + min(data[at], 8)], "little"), OTHER_TRANSPORT))


def decode(data: bytes) -> Message:
    """Decodes a message after checking its size and checksum.

    Raises:
        UnsupportedVersionError: If the datagram has another protocol version.
        BitstreamError: If the datagram is truncated, damaged or malformed.
    """
    if not data or len(data) > MAX_DATAGRAM:
        raise BitstreamError(f"a datagram of {len(data)} bytes is not a splatwire datagram")
    kind = message_kind(data)
    if not kind:
        if data[0] >> 4 != VERSION:
            raise UnsupportedVersionError(f"a datagram of protocol version {data[0] >> 4}, not {VERSION}")
        raise BitstreamError(f"a datagram of unknown kind {data[0] & 15}")
    if kind == DATA:
        if len(data) <= _DATA.size:
            raise BitstreamError("a data datagram without a packet")
        _, session, sequence, packet_index = _DATA.unpack_from(data)
        return Data(session, sequence, packet_index, data[_DATA.size :])
    if len(data) < _CRC.size + 1 or not _is_intact(data):
        raise BitstreamError(f"a {MESSAGE_KINDS[kind]} datagram whose checksum does not match")
    try:
        return _DECODERS[kind](data[: -_CRC.size])
    except struct.error as error:
        raise BitstreamError(f"a {MESSAGE_KINDS[kind]} datagram of {len(data)} bytes is cut") from error


def _is_intact(data: bytes) -> bool:
    return zlib.crc32(data[: -_CRC.size]) == _CRC.unpack_from(data, len(data) - _CRC.size)[0]


def _with_checksum(body: bytes) -> bytes:
    return body + _CRC.pack(zlib.crc32(body))


def _unpack_exact(layout: struct.Struct, body: bytes) -> tuple[Any, ...]:
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
    name, scene_token = _name(body, _REQUEST.size, size), body[_REQUEST.size + size :]
    if len(scene_token) > MAX_SCENE_TOKEN or not (scene_token.isascii() and scene_token.decode().isprintable()):
        raise BitstreamError("a request whose token is too long or not printable")
    return Request(nonce, token, name, scene_token.decode())


def _welcome(body: bytes) -> Welcome:
    *fields, flags, count = _WELCOME.unpack_from(body)
    end = _WELCOME.size + count * _PARITY_RANGE.size
    (size,) = _SIZE.unpack_from(body, end)
    declared = count * _PARITY_RANGE.size + size
    if (
        not 1 <= count <= MAX_PARITY_RANGES
        or size > MAX_PREVIEW
        or declared > MAX_DECLARED
        or len(body) != end + _SIZE.size + size
    ):
        raise BitstreamError("a welcome of inconsistent size")
    if flags & ~(LIVE | VIEW_DEPENDENT):
        raise BitstreamError(f"a welcome with the unknown flags {flags:#x}")
    ranges = tuple(ParityRange(*values) for values in _PARITY_RANGE.iter_unpack(body[_WELCOME.size : end]))
    is_live, view_dependent = bool(flags & LIVE), bool(flags & VIEW_DEPENDENT)
    return Welcome._make([*fields[1:], ranges, body[end + _SIZE.size :], is_live, view_dependent])


def _feedback(body: bytes) -> Feedback:
    *fields, num_packets, num_datagrams = _FEEDBACK.unpack_from(body)
    count = num_packets + num_datagrams
    if count > MAX_NACKS or len(body) != _FEEDBACK.size + 4 * count:
        raise BitstreamError("a feedback report of inconsistent size")
    requested = struct.unpack_from(f"<{count}I", body, _FEEDBACK.size)
    return Feedback._make([*fields[1:], requested[:num_packets], requested[num_packets:]])


def _have(body: bytes) -> Have:
    _, nonce, stream_id, has_init_segment, first = _HAVE.unpack_from(body)
    held = body[_HAVE.size :]
    if has_init_segment > 1 or first % 8 or len(held) > MAX_HELD_BYTES:
        raise BitstreamError("an inconsistent list of received packets")
    return Have(nonce, stream_id, has_init_segment, first, held)


def _symbol(body: bytes) -> tuple[Any, ...]:
    fields = _INIT_SYMBOL.unpack_from(body)[1:]
    if len(body) == _INIT_SYMBOL.size:
        raise BitstreamError("a symbol without content")
    return (*fields, body[_INIT_SYMBOL.size :])


def _view_update(body: bytes) -> ViewUpdate:
    *fields, focal = _unpack_exact(_VIEW_UPDATE, body)[:6]
    rows = _VIEW_UPDATE.unpack(body)[7:]
    viewmat = np.array(rows, dtype=np.float64).reshape(3, 4)
    is_in_range = (
        np.isfinite(viewmat).all()
        and 0 < focal < MAX_FOCAL
        and min(fields[2:]) > 0
        and np.abs(viewmat).max() < MAX_COORDINATE
    )
    if not is_in_range or np.abs(viewmat[:, :3] @ viewmat[:, :3].T - np.eye(3)).max() > MAX_ROTATION_ERROR:
        raise BitstreamError("a view update with an invalid camera")
    return ViewUpdate._make([*fields, focal, rows])


_DECODERS: dict[int, Callable[[bytes], Message]] = {
    HELLO: _hello,
    CHALLENGE: lambda body: Challenge(*_unpack_exact(_CHALLENGE, body)),
    REQUEST: _request,
    WELCOME: _welcome,
    INIT_SYMBOL: lambda body: InitSymbol(*_symbol(body)),
    PARITY: lambda body: Parity(*_symbol(body)),
    FEEDBACK: _feedback,
    BYE: lambda body: Bye(*_unpack_exact(_BYE, body)),
    REFUSE: lambda body: Refuse(*_unpack_exact(_REFUSE, body)),
    VIEW_UPDATE: _view_update,
    END: lambda body: End(*_unpack_exact(_END, body)),
    HAVE: _have,
}
