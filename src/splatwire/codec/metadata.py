"""Metadata of a scene, stored in named sections of the side information."""

import json
from collections.abc import Mapping

from splatwire.codec.viewpoint import SECTION as VIEWPOINT
from splatwire.codec.viewpoint import UP_SECTION
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types.metadata import UP_AXES, SceneMetadata, StartView, metadata_from_json, metadata_to_json

SECTION = "metadata"
"""Name of the section; its content is a JSON object with `title`, `author`, `license` and `orbit`, as far as known."""
_MAX_BYTES = 1 << 16


def metadata_sections(metadata: SceneMetadata) -> dict[str, bytes]:
    """Returns metadata as named sections of the side information: one section for each field that has a value."""
    content = metadata_to_json(metadata)
    sections = {}
    up, view = content.pop("up", None), content.pop("view", None)
    if up is not None:
        sections[UP_SECTION] = up.encode()
    if view is not None:
        writer = ByteWriter()
        for value in view:
            writer.f32(value)
        sections[VIEWPOINT] = writer.bytes()
    if content:
        sections[SECTION] = json.dumps(content, sort_keys=True, ensure_ascii=False).encode()
    return sections


def read_metadata(sections: Mapping[str, bytes]) -> SceneMetadata:
    """Parses the metadata in named sections.

    Initial view and up axis are not validated; the caller must have checked them with `check_viewpoint`.

    Raises:
        BitstreamError: If the section `metadata` is not a JSON object, or is larger than 64 KiB.
    """
    data = sections.get(SECTION, b"{}")
    try:
        content = json.loads(data.decode("utf-8")) if len(data) <= _MAX_BYTES else None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise BitstreamError(f"section '{SECTION}' is no JSON object of at most {_MAX_BYTES:,} bytes")
    texts = {name: value for name, value in content.items() if name not in ("up", "view")}
    up = sections.get(UP_SECTION, b"").decode("latin-1")
    metadata = metadata_from_json(texts | ({"up": up} if up in UP_AXES else {}))
    if VIEWPOINT not in sections:
        return metadata
    reader = ByteReader(sections[VIEWPOINT], f"section '{VIEWPOINT}'")
    numbers = [reader.f32() for _ in range(9)]
    return SceneMetadata(
        metadata.title, metadata.author, metadata.license, metadata.up, StartView.of(numbers), metadata.orbit
    )
