"""Finds a stream within binary glTF (extension EXT_splatwire, `docs/gltf.md`)."""

import json
import struct
from typing import Any

from splatwire.errors import BitstreamError
from splatwire.files.kinds import EXT_SPLATWIRE, GLB_MAGIC, MAX_GLB_JSON_BYTES

KHR_SPLATTING = "KHR_gaussian_splatting"
HEAD_BYTES = 20
"""Size of the file header and the first chunk's header, bytes."""
_HEAD, _CHUNK = struct.Struct("<4sIII4s"), struct.Struct("<I4s")


def json_size(head: bytes, name: str) -> int:
    """Returns how many bytes of a binary glTF file (`.glb`) lie between its first 20 bytes and its binary data.

    These bytes are the JSON document and the header of the binary chunk.

    Args:
        head: The first 20 bytes of the file.
        name: Source of the bytes, for error messages.

    Raises:
        BitstreamError: If the file is not binary glTF of version 2, or the JSON exceeds `MAX_GLB_JSON_BYTES`.
    """
    if len(head) < _HEAD.size:
        raise BitstreamError(f"{name}: the glTF file ends after {len(head)} bytes")
    magic, version, _, size, kind = _HEAD.unpack(head)
    if magic != GLB_MAGIC or version != 2 or kind != b"JSON" or size > MAX_GLB_JSON_BYTES:
        raise BitstreamError(f"{name}: no binary glTF of version 2 with at most {MAX_GLB_JSON_BYTES:,} bytes of JSON")
    return int(size) + _CHUNK.size


def stream_location(text: bytes, name: str) -> tuple[int, int]:
    """Returns the position and size of the stream that is embedded in a binary glTF file.

    Args:
        text: Bytes of the file after the first 20, up to its binary data (see `json_size`).
        name: Source of the bytes, for error messages.

    Returns:
        Offset of the stream's first byte in the file, and the stream's size in bytes.

    Raises:
        BitstreamError: If the document does not locate exactly one stream within the binary chunk.
    """
    try:
        size, kind = _CHUNK.unpack(text[-_CHUNK.size :])
        start, length = _embedded_range(json.loads(text[: -_CHUNK.size]))
    except (struct.error, ValueError, RecursionError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise BitstreamError(f"{name}: the glTF document is damaged: {type(error).__name__} {error}") from error
    if kind != b"BIN\0" or not 0 <= start <= size or not 0 <= length <= size - start:
        raise BitstreamError(f"{name}: its stream, {length} bytes from {start} on, is not within {size} binary bytes")
    return HEAD_BYTES + len(text) + start, length


def _embedded_range(document: dict[str, Any]) -> tuple[int, int]:
    """Returns the byte offset and the size of the embedded stream within the binary chunk of a `.glb` file.

    Args:
        document: JSON document of the file.
    """
    extensions = [
        primitive["extensions"][KHR_SPLATTING]["extensions"][EXT_SPLATWIRE]
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        if EXT_SPLATWIRE in primitive.get("extensions", {}).get(KHR_SPLATTING, {}).get("extensions", {})
    ]
    if len(extensions) != 1:
        raise ValueError(f"{len(extensions)} primitives with {EXT_SPLATWIRE}, exactly one is read")
    index = extensions[0]["bufferView"]
    if type(index) is not int or index < 0:
        raise ValueError(f"bufferView is {index!r:.40}")
    view = document["bufferViews"][index]
    offset, length, buffer = view.get("byteOffset", 0), view["byteLength"], view["buffer"]
    if type(offset) is not int or type(length) is not int or buffer != 0 or type(buffer) is not int:
        raise ValueError("the stream's bufferView is none of the binary chunk")
    return offset, length
