"""Extension records of SPZ files, each of which has a type, a size and content."""

import json
import logging
import struct
from collections.abc import Iterator
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.io.formats._asset import ORIGIN, origin_of_json
from splatwire.types.metadata import NO_METADATA, SceneMetadata, metadata_from_json, metadata_to_json
from splatwire.types.origin import NO_ORIGIN, Origin

LOG = logging.getLogger(__name__)

MAX_EXTENSION_BYTES = 1 << 20
"""Maximum total size of the records of a file, bytes."""
_RECORD = struct.Struct("<II")
SAFE_ORBIT, COORDINATE_SYSTEM = 0xADBE0002, 0xADBE0003
FRAMES = (
    "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU",
)  # fmt: skip
"""Axis conventions of the extension `SPZ_ADOBE_coordinate_system`, from code 1; 0 means the default."""
FRAME = "RUB"
_METADATA = 0x53570001
"""Record type of this package: metadata and origin of the scene as a JSON object, in the axes of a 3DGS PLY."""
KNOWN = (SAFE_ORBIT, COORDINATE_SYSTEM, _METADATA)
_ORBIT = struct.Struct("<3f")


def metadata_of_records(path: Path, extensions: dict[int, bytes]) -> SceneMetadata:
    """Parses the scene metadata in the extension records of an SPZ file; logs a warning about invalid ones.

    Args:
        path: The file, for warnings.
        extensions: Content of each extension record by its type.
    """
    metadata = NO_METADATA
    if _METADATA in extensions:
        try:
            metadata = metadata_from_json(json.loads(extensions[_METADATA].decode("utf-8")), path)
        except (ValueError, RecursionError):
            LOG.warning("%s: its metadata are damaged: they are left out", path)
    if SAFE_ORBIT not in extensions:
        return metadata
    if len(orbit := extensions[SAFE_ORBIT]) != _ORBIT.size:
        LOG.warning("%s: its limits of the orbit have %d bytes, not %d: left out", path, len(orbit), _ORBIT.size)
        return metadata
    return metadata_from_json({"orbit": list(_ORBIT.unpack(orbit))}, path).over(metadata)


def origin_of_records(path: Path, extensions: dict[int, bytes]) -> Origin:
    """Returns the origin in the extension records of an SPZ file; `NO_ORIGIN` without a valid one.

    Args:
        path: The file, for warnings.
        extensions: Content of each extension record by its type.
    """
    try:
        return origin_of_json(json.loads(extensions.get(_METADATA, b"{}").decode("utf-8")), path)
    except (ValueError, RecursionError):
        return NO_ORIGIN


def write_records(metadata: SceneMetadata, origin: Origin = NO_ORIGIN) -> bytes:
    """Serialises the metadata of a scene as extension records; empty if there is none.

    Args:
        metadata: The metadata.
        origin: World coordinates of the point that positions are relative to.
    """
    content, records = metadata_to_json(metadata), b""
    if origin != NO_ORIGIN:
        content[ORIGIN] = list(origin)
    if metadata.orbit is not None:
        records += _RECORD.pack(SAFE_ORBIT, _ORBIT.size) + _ORBIT.pack(*content.pop("orbit"))
    if content:
        text = json.dumps(content, ensure_ascii=False).encode()
        records += _RECORD.pack(_METADATA, len(text)) + text
    return records


def frame_of(path: Path, extensions: dict[int, bytes]) -> str:
    """Returns the axis convention (coordinate frame) that the extension records of an SPZ file declare, such as `RUB`.

    The result is the convention of the format if no record declares one.

    Args:
        path: The file, for messages.
        extensions: Content of each extension record by its type.

    Raises:
        DatasetError: If the record of the axis convention has a wrong size or an unknown code.
    """
    content = extensions.get(COORDINATE_SYSTEM)
    if content is None:
        return FRAME
    code = int.from_bytes(content[:4], "little")
    if len(content) != 4 or code > len(FRAMES):
        raise DatasetError(
            f"{path}: extension SPZ_ADOBE_coordinate_system has {len(content)} bytes and names frame {code}; it has 4 "
            f"bytes and names 1 to {len(FRAMES)}, or 0 for none"
        )
    return FRAMES[code - 1] if code else FRAME


def split_records(path: Path, data: bytes | memoryview) -> list[tuple[int, bytes]]:
    """Splits the extension part of an SPZ file into records; returns the type and the content of each.

    Args:
        path: The file, for messages.
        data: The extension part.

    Raises:
        DatasetError: If a record exceeds the data.
    """
    return list(_each_record(path, data))


def records_by_type(path: Path, records: list[tuple[int, bytes]]) -> dict[int, bytes]:
    """Returns extension records as a mapping from type to content.

    Args:
        path: The file, for messages.
        records: Type and content of each record.

    Raises:
        DatasetError: If a type occurs twice.
    """
    content_by_type: dict[int, bytes] = {}
    for kind, content in records:
        if kind in content_by_type:
            raise DatasetError(f"{path}: extension 0x{kind:08X} is there twice")
        content_by_type[kind] = content
    return content_by_type


def _each_record(path: Path, data: bytes | memoryview) -> Iterator[tuple[int, bytes]]:
    offset = 0
    if len(data) > MAX_EXTENSION_BYTES:
        raise DatasetError(f"{path}: {len(data):,} bytes of extensions, at most {MAX_EXTENSION_BYTES:,} are read")
    while any(data[offset:]):  # zeros at the end are padding
        kind, size = _RECORD.unpack_from(data, offset) if offset + _RECORD.size <= len(data) else (0, len(data))
        offset += _RECORD.size
        if not kind or size > len(data) - offset:
            raise DatasetError(f"{path}: an extension record of {size:,} bytes ends after its {len(data):,} bytes")
        yield kind, bytes(data[offset : offset + size])
        offset += size
