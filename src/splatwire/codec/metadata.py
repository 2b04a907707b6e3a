"""Metadata of a scene, stored in named sections of the side information."""

import json
import logging
import math
from collections.abc import Mapping

import numpy as np

from splatwire.codec.initial_view import MAX_UP, MIN_UP, UP_SECTION
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader
from splatwire.types.metadata import UP_AXES, SceneMetadata, metadata_from_json, metadata_to_json

LOG = logging.getLogger(__name__)
SECTION = "metadata"
"""Name of the section; its content is a JSON object with `title`, `author`, `license` and `orbit`, as far as known."""
_MAX_BYTES = 1 << 16


def metadata_sections(metadata: SceneMetadata) -> dict[str, bytes]:
    """Returns metadata as named sections of the side information.

    The up axis and the initial view have sections of their own; all other known fields are in the section `metadata`.
    """
    content = metadata_to_json(metadata)
    sections = {}
    up, view = content.pop("up", None), content.pop("view", None)
    if up is not None:
        sections[UP_SECTION] = up.encode()
    if view is not None and (data := _initial_view_section(view)) is not None:
        sections[INITIAL_VIEW] = data
    if content:
        sections[SECTION] = json.dumps(content, sort_keys=True, ensure_ascii=False).encode()
    return sections


def _initial_view_section(view: list[float]) -> bytes | None:
    """Serialises an initial view; logs a warning and returns None if eye and target are equal in float32.

    Args:
        view: Eye, target and up, nine numbers.
    """
    numbers = np.array(view, np.float32)
    if (numbers[:3] == numbers[3:6]).all():
        LOG.warning(
            "the initial view is left out: its eye and target, %s and %s, are the same point in float32",
            tuple(view[:3]), tuple(view[3:6]),
        )  # fmt: skip
        return None
    if not MIN_UP < math.hypot(*numbers[6:].tolist()) < MAX_UP:
        numbers[6:] = np.array(view[6:]) / math.hypot(*view[6:])
    return numbers.astype("<f4").tobytes()


def read_metadata(sections: Mapping[str, bytes]) -> SceneMetadata:
    """Parses the metadata in named sections.

    The caller must have checked initial view and up axis with `check_view_sections`.

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
    fields: dict[str, object] = {**texts, **({"up": up} if up in UP_AXES else {})}
    if INITIAL_VIEW in sections:
        reader = ByteReader(sections[INITIAL_VIEW], f"section '{INITIAL_VIEW}'")
        fields["view"] = [reader.f32() for _ in range(9)]
    return metadata_from_json(fields, "the stream")
