"""Metadata of a scene in the comments of a PLY.

`title: …`, `author: …`, `license: …`, `up: -y` and `view: …` of nine numbers. Nerfstudio writes `Vertical Axis: z`.
"""

import re
from collections.abc import Iterable

from splatwire.scene.metadata import SceneMetadata, metadata_from_json, metadata_to_json

_NAMES = {
    "title": r"title|name|scene",
    "author": r"author|creator|artist|made[-_ ]by",
    "license": r"licen[cs]e|copyright|rights",
    "up": r"up(?:[-_ ]?axis)?|vertical[-_ ]axis",
    "view": r"view|start[-_ ](?:view|camera)|viewpoint",
    "orbit": r"orbit",
}
_LINES = {name: re.compile(rf"(?:{words})\s*[:=]\s*(.+)", re.IGNORECASE) for name, words in _NAMES.items()}
_AXIS = re.compile(r"([+-]?)\s*([xyz])", re.IGNORECASE)


def stated_metadata(comments: Iterable[str]) -> SceneMetadata:
    """Returns the metadata in comments; the last comment of a name counts.

    Args:
        comments: Text of each comment, without the word `comment`.
    """
    found: dict[str, object] = {}
    for comment in comments:
        for name, line in _LINES.items():
            if match := line.fullmatch(comment.strip()):
                found[name] = _value(name, match[1].strip())
    return metadata_from_json(found)


def metadata_comments(metadata: SceneMetadata) -> list[str]:
    """Returns a comment for each field that is known."""
    found = metadata_to_json(metadata)
    return [f"{name}: {_text(value)}" for name, value in found.items()]


def _text(value: object) -> str:
    if isinstance(value, list):
        return " ".join(repr(number) for number in value)
    return str(value).replace("end_header", "end header")  # simple readers search for the word


def _value(name: str, text: str) -> object:
    if name == "up":
        axis = _AXIS.fullmatch(text)
        return None if axis is None else f"{axis[1].replace('+', '')}{axis[2].lower()}"
    if name in ("view", "orbit"):
        try:
            return [float(word) for word in re.split(r"[\s,]+", text.strip("[]() "))]
        except ValueError:
            return None
    return text
