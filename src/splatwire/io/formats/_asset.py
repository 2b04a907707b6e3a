"""Metadata in the `asset` object of glTF and SOG: `copyright`, and fields of `extras`."""

import logging
from pathlib import Path
from typing import Any

from splatwire.errors import InvalidValueError
from splatwire.io.formats._placement import warn_of_unused_fields
from splatwire.types.metadata import (
    MAX_TEXT,
    NO_METADATA,
    SceneMetadata,
    clean_text,
    metadata_from_json,
    metadata_to_json,
)
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin
from splatwire.version import __version__

LOG = logging.getLogger(__name__)
_OWN = "splatwire"
"""Key of the object in `extras` with metadata without a standard field (up axis, view), in the axes of a 3DGS PLY."""
ORIGIN = "origin"
"""Field of this object with the origin in SOG and SPZ, three numbers."""
_TEXTS = ("title", "author", "license")
_XMP = ("KHR_xmp_json_ld", "KHR_xmp")
"""Extensions with XMP packets; the second one is deprecated."""
_XMP_FIELDS = (("title", "dc:title"), ("author", "dc:creator"), ("license", "dc:rights"))
"""Fields of metadata and the XMP properties that they are read from."""
_XMP_VALUES, _MAX_XMP_DEPTH = ("@value", "@list", "@set", "rdf:_1"), 4
"""Keys of the values of XMP properties, and the maximum depth of the search for them."""


def asset_of(metadata: SceneMetadata, origin: Origin = NO_ORIGIN) -> dict[str, Any]:
    """Returns a glTF `asset` object with the program's name and a scene's metadata.

    Args:
        metadata: The metadata.
        origin: World coordinates of the point that positions are relative to. Formats that store the origin elsewhere
            omit this argument.
    """
    content = metadata_to_json(metadata)
    if origin != NO_ORIGIN:
        content[ORIGIN] = list(origin)
    extras: dict[str, Any] = {name: content.pop(name) for name in _TEXTS if name in content}
    notice = ", ".join(extras[name] for name in ("author", "license") if name in extras)
    if content:
        extras[_OWN] = content
    return {
        "generator": f"splatwire {__version__}",
        **({"copyright": notice} if notice else {}),
        **({"extras": extras} if extras else {}),
    }


def metadata_of_asset(asset: object, path: Path, rights: str = "") -> SceneMetadata:
    """Parses the metadata of a glTF or SOG `asset` object; logs a warning about invalid fields.

    Different statements about the license are joined: the license, `rights` and the copyright notice.

    Args:
        asset: The object.
        path: The file, for warnings.
        rights: License or copyright notice that another part of the file states; empty if there is none.
    """
    if not isinstance(asset, dict):
        return SceneMetadata(license=rights)
    extras_value = asset.get("extras")
    extras = extras_value if isinstance(extras_value, dict) else {}
    own_fields = extras.get(_OWN)
    texts = {name: extras[name] for name in _TEXTS if name in extras}
    stated = [text for name in ("author", "license") if (text := _joinable(texts.get(name)))]
    notice = _joinable(asset.get("copyright"))
    licenses = [
        _joinable(texts.get("license")),
        *rights.split("; "),
        "" if notice in (*stated, ", ".join(stated)) else notice,
    ]
    if different := list(dict.fromkeys(filter(None, licenses))):
        texts["license"] = "; ".join(different)
    return metadata_from_json((own_fields if isinstance(own_fields, dict) else {}) | texts, path)


def _joinable(value: object) -> str:
    """Returns a text as one line. It is cut at `4 * MAX_TEXT` characters only, because others may be joined to it."""
    return clean_text(value, 4 * MAX_TEXT)


def metadata_of_xmp(document: dict[str, Any], path: Path) -> SceneMetadata:
    """Parses title, creator and rights in the XMP packet of a glTF document (extension KHR_xmp_json_ld).

    Args:
        document: The document.
        path: The file, for warnings.
    """
    for name in _XMP:
        used, packets = (_extension(part, name) for part in (document.get("asset"), document))
        index, entries = used.get("packet"), packets.get("packets")
        if type(index) is int and isinstance(entries, list) and 0 <= index < len(entries):
            packet = entries[index]
            fields = (
                {field: _xmp_texts(packet.get(key)) for field, key in _XMP_FIELDS} if isinstance(packet, dict) else {}
            )
            return metadata_from_json({field: "; ".join(texts) for field, texts in fields.items() if texts}, path)
    return NO_METADATA


def _extension(part: object, name: str) -> dict[str, Any]:
    """Returns the content of an extension of a glTF object; empty without it."""
    extensions = part.get("extensions") if isinstance(part, dict) else None
    content = extensions.get(name) if isinstance(extensions, dict) else None
    return content if isinstance(content, dict) else {}


def _xmp_texts(value: object) -> list[str]:
    """Returns the texts of an XMP property: a text, a list, or the first language of several."""
    for _ in range(_MAX_XMP_DEPTH):
        if isinstance(value, dict):
            value = next((value[key] for key in _XMP_VALUES if key in value), None)
    entries = value if isinstance(value, list) else [value]
    texts = [_joinable(entry.get("@value") if isinstance(entry, dict) else entry) for entry in entries]
    return [text for text in dict.fromkeys(texts) if text]


def origin_of_asset(asset: object, path: Path) -> Origin:
    """Returns the origin in a SOG `asset` object; `NO_ORIGIN` without a valid one.

    Args:
        asset: The object.
        path: The file, for warnings.
    """
    extras = asset.get("extras") if isinstance(asset, dict) else None
    return origin_of_json(extras.get(_OWN) if isinstance(extras, dict) else None, path)


def origin_of_json(content: object, path: Path) -> Origin:
    """Returns the origin in the metadata that this package writes as a JSON object.

    The result is `NO_ORIGIN` without an origin, and, with a warning, for an invalid one.

    Args:
        content: The JSON object.
        path: The file, for warnings.
    """
    if not isinstance(content, dict) or ORIGIN not in content:
        return NO_ORIGIN
    try:
        return check_origin(content[ORIGIN])
    except InvalidValueError as error:
        LOG.warning("%s: its origin is left out, so positions are read as they are in the file: %s", path, error)
        return NO_ORIGIN


def warn_of_unused_extras(path: Path, asset: object) -> None:
    """Logs a warning about fields in `extras` that are not applied and may move, scale or rotate the scene."""
    extras = asset.get("extras") if isinstance(asset, dict) else None
    if isinstance(extras, dict):
        warn_of_unused_fields(path, {name: extras[name] for name in extras if name not in (_OWN, *_TEXTS)})
