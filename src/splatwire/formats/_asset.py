"""Metadata of a scene in the `asset` of glTF, which SOG has, too: `copyright`, and fields of `extras`."""

from typing import Any

from splatwire.scene.metadata import NO_METADATA, SceneMetadata, clean_text, metadata_from_json, metadata_to_json
from splatwire.version import __version__

_OWN = "splatwire"
"""Object in `extras` for what others have no name for, in the axes of a 3DGS PLY."""
_TEXTS = ("title", "author", "license")


def asset_of(metadata: SceneMetadata) -> dict[str, Any]:
    """Returns an `asset` with the program's name and the metadata."""
    content = metadata_to_json(metadata)
    extras: dict[str, Any] = {name: content.pop(name) for name in _TEXTS if name in content}
    notice = ", ".join(extras[name] for name in ("author", "license") if name in extras)
    if content:
        extras[_OWN] = content
    return {
        "generator": f"splatwire {__version__}",
        **({"copyright": notice} if notice else {}),
        **({"extras": extras} if extras else {}),
    }


def metadata_of_asset(asset: object) -> SceneMetadata:
    """Returns the metadata in an `asset`; `copyright` is the license where `extras` has neither author nor license."""
    if not isinstance(asset, dict):
        return NO_METADATA
    given = asset.get("extras")
    extras = given if isinstance(given, dict) else {}
    own = extras.get(_OWN)
    texts = {name: extras[name] for name in _TEXTS if name in extras}
    if not {"author", "license"} & set(texts) and clean_text(asset.get("copyright")):
        texts["license"] = asset["copyright"]
    return metadata_from_json((own if isinstance(own, dict) else {}) | texts)
