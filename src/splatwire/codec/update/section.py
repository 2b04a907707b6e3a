"""Part of an update's side information: the removed Gaussians, and digests of the streams before and after it."""

import hashlib
from typing import NamedTuple

from splatwire.bitstream import Manifest, manifest_to_bytes
from splatwire.bitstream.limits import MAX_WRITER_LENGTH
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter

SECTION = "update"
VERSION = 1
_DIGEST_BYTES = 32


class UpdateFields(NamedTuple):
    """Fields of an update, apart from new Gaussians: digests of old and new stream, and removed Gaussians.

    Attributes:
        base_digest: SHA-256 of the manifest before the update, hexadecimal.
        result_digest: SHA-256 of the manifest after the update, hexadecimal.
        writer: Name of the program that wrote the new version of the stream, for the manifest of this version.
        removed: Mask of the removed Gaussians, serialised.
    """

    base_digest: str
    result_digest: str
    writer: str
    removed: bytes


def manifest_digest(manifest: Manifest) -> str:
    """Returns the SHA-256 of a manifest, hexadecimal, which identifies the stream and its content."""
    return hashlib.sha256(manifest_to_bytes(manifest)).hexdigest()


def update_name(base_digest: str) -> str:
    """Returns the name by which receivers request the update of a stream from a server.

    Args:
        base_digest: Digest of the stream that the update changes (`manifest_digest`), hexadecimal.
    """
    return f"update.{base_digest[:16]}"


def write_update(fields: UpdateFields) -> bytes:
    """Serialises the fields of an update (digests, removed Gaussians) for the side information."""
    writer = ByteWriter()
    writer.u8(VERSION)
    head = writer.bytes() + bytes.fromhex(fields.base_digest) + bytes.fromhex(fields.result_digest)
    writer = ByteWriter()
    writer.blob(fields.writer.encode("ascii"))
    return head + writer.bytes() + fields.removed


def read_update(data: bytes) -> UpdateFields:
    """Parses the fields of an update (digests, removed Gaussians) from the side information.

    Raises:
        UnsupportedVersionError: If a newer release wrote the update.
        BitstreamError: If the bytes are damaged.
    """
    reader = ByteReader(data, f"section '{SECTION}'")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"section '{SECTION}' has version {version}, this release reads {VERSION}")
    base, result = (bytes(reader.take(_DIGEST_BYTES)).hex() for _ in range(2))
    writer = bytes(reader.blob())
    if len(writer) > MAX_WRITER_LENGTH or not all(32 <= letter < 127 for letter in writer):
        raise BitstreamError(f"section '{SECTION}': the writer is not printable ASCII of {MAX_WRITER_LENGTH} letters")
    return UpdateFields(base, result, writer.decode("ascii"), bytes(reader.rest()))
