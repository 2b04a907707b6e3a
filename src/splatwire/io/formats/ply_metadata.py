"""Metadata of a scene in PLY comments.

This package writes `title: …`, `author: …`, `license: …`, `up: -y`, `view: …` with nine numbers and `orbit: …` with
three. Common variants of other programs are read too, such as `Vertical Axis: z`, `Copyright 2024 A. B.` or the name of
a license.
"""

import math
import re
from collections.abc import Iterable
from pathlib import Path

from splatwire.errors import InvalidValueError
from splatwire.types.metadata import (
    SceneMetadata,
    metadata_from_json,
    metadata_to_json,
    parse_field,
    warn_of_long_texts,
)

_NAMES = {
    "title": r"title|name|scene",
    "author": r"author|creator|artist|made[-_ ]by",
    "license": r"licen[cs]e|copyright|rights|spdx-licen[cs]e-identifier|spdx-filecopyrighttext",
    "up": r"up(?:[-_ ]?axis)?|vertical[-_ ]axis",
    "view": r"view|start[-_ ](?:view|camera)|viewpoint",
    "orbit": r"orbit",
}
_LINES = {name: re.compile(rf"(?:{words})\s*[:=]\s*(.+)", re.IGNORECASE) for name, words in _NAMES.items()}
_PLAIN_LINES = {
    "title": re.compile(r"title\s+(.+)", re.IGNORECASE),
    "author": re.compile(r"(?:author|artist)s?\s+(.+)", re.IGNORECASE),
    "license": re.compile(
        r"(?:licen[cs]e|licen[cs]ed(?:\s+(?:under|as))?|spdx-licen[cs]e-identifier)\s+(.+)"
        r"|((?:copyright|\(c\)|©)\s*.+|all rights reserved.*)",
        re.IGNORECASE,
    ),
}
"""Patterns of comments without a colon. A copyright notice is kept whole."""
_NOTICE = re.compile(r"copyright\b|\(c\)|©|all rights reserved", re.IGNORECASE)
"""Start of a copyright notice, which is kept in addition to a license."""
_WORK = r"photo(?:s|graph(?:s|ed|y)?)?|captured?|scan(?:s|ned)?|model|shot"
_CREDITS = {
    "author": re.compile(
        r"(?:credits?(?:\s+to)?|attribution|courtesy(?:\s+of)?|photographer)(?:\s*[:=]\s*|\s+)(.+)"
        rf"|(?:(?:{_WORK})\s+)?by(?:\s*[:=]\s*|\s+)((?-i:[A-Z@\"'\u00c0-\uffff]).*)",
        re.IGNORECASE,
    ),
    "license": re.compile(
        r"(CC[- ]?(?:BY|0)\b[-\w. ]*|creative\s+commons\b.*|public\s+domain\W*"
        r"|https?://(?:www\.)?creativecommons\.org/\S+)",
        re.IGNORECASE,
    ),
}
"""Patterns of comments that name people, or a licence alone; they apply if no other comment states the field."""
_PCL_VIEWPOINT = 7
"""Number of values of a viewpoint of the Point Cloud Library (PCL): position and quaternion."""
_AXIS = re.compile(r"([+-]?)\s*([xyz])(?:[-_ ]?up|[-_ ]?axis)?", re.IGNORECASE)
_UP = re.compile(
    r"(?:world\s+)?(?:up(?:[-_ ]?(?:axis|vector|dir(?:ection)?))?|vertical[-_ ]axis)(?:\s*[:=]\s*|\s+)(.+)"
    r"|([+-]?[xyz][-_ ]?up)",
    re.IGNORECASE,
)
"""Pattern of comments about the axis that is up: its name, or a vector."""
_VERTICAL_Y = re.compile(r"vertical[-_ ]axis(?:\s*[:=]\s*|\s+)y", re.IGNORECASE)
"""Comment of Brush about a scene in the axes of 3DGS, in which y is vertical and points down."""
_VERTICAL_VECTOR = re.compile(r"vertical[-_ ]axis\s*[:=]\s*(.*\d.*)", re.IGNORECASE)
"""Comment of Brush with a vector for its viewer. A vector within 37 degrees of z is read as the opposite direction,
one near y as it is, and one near x as no axis, because x of these vectors is not reliable. Vectors that are exactly a
coordinate axis, such as `0 0 1`, are those of other programs and read as they are."""
_MIN_UP_SHARE = 0.8
"""Smallest share of a vector's length along the axis that it names, for an angle of 37 degrees."""


def stated_metadata(comments: Iterable[str], path: Path | None = None) -> SceneMetadata:
    """Parses the scene's metadata in PLY comments.

    Several authors, licenses and copyright notices are joined. Of other fields, the last comment applies; a `title`
    precedes a `name`.

    Args:
        comments: Text of each comment, without the word `comment`.
        path: The file, for a warning about a text that is too long; None for no warning.
    """
    fields: dict[str, list[object]] = {}
    plain: dict[str, list[object]] = {}
    credits: dict[str, list[object]] = {}
    for comment in map(str.strip, comments):
        stated = {name: match for name, line in _LINES.items() if (match := line.fullmatch(comment))}
        for name, match in stated.items():
            if name != "up":
                is_other_name = name == "title" and not comment.lower().startswith("title")
                found = plain if is_other_name else fields
                found.setdefault(name, []).append(_value(name, match[1].strip()))
        if not stated:
            for lines, found in ((_PLAIN_LINES, plain), (_CREDITS, credits)):
                for name, text in _stated_fields(lines, comment).items():
                    found.setdefault(name, []).append(text)
        if (up := named_up(comment)) is not None:
            fields["up"] = [up]
    chosen = credits | plain | fields
    if "license" in fields:
        chosen["license"] = [*fields["license"], *(text for text in plain.get("license", []) if _is_notice(text))]
    content = {name: _joined(name, values) for name, values in chosen.items()}
    if path is not None:
        warn_of_long_texts(content, path)
    return metadata_from_json(content)


def _joined(name: str, values: list[object]) -> object:
    """Returns the value of a metadata field that is stated several times: all texts, or the last value.

    Args:
        name: Name of the field.
        values: Its values, in the order of the comments.
    """
    if name not in ("author", "license"):
        return values[-1]
    return "; ".join(dict.fromkeys(map(str, values)))


def _is_notice(text: object) -> bool:
    return isinstance(text, str) and _NOTICE.match(text) is not None


def _stated_fields(lines: dict[str, re.Pattern[str]], comment: str) -> dict[str, str]:
    """Returns the metadata fields of a PLY comment, such as title and author, by field name.

    Args:
        lines: Pattern of the comments that contain a field, by field name.
        comment: The comment.
    """
    matches = {name: line.fullmatch(comment) for name, line in lines.items()}
    return {name: match[match.lastindex or 0].strip() for name, match in matches.items() if match}


def is_metadata(comment: str) -> bool:
    """True if a comment states metadata: title, author, license, view or orbit."""
    lines = [line for name, line in _LINES.items() if name != "up"]
    lines += [*_PLAIN_LINES.values(), *_CREDITS.values()]
    return any(line.fullmatch(comment.strip()) for line in lines)


def invalid_view(comment: str) -> str | None:
    """Returns the reason why a PLY comment with an initial view or orbit limits is invalid.

    The result is None for a valid comment, and for a comment with another meaning. Comments of other programs may also
    start with `view` or `orbit`: sentences, addresses, and the viewpoint of the Point Cloud Library (position and
    quaternion).
    """
    for name in ("view", "orbit"):
        if (match := _LINES[name].fullmatch(comment.strip())) is not None:
            text = match[1].strip()
            numbers = _numbers(text)
            meant = text.isalpha() if numbers is None else name == "orbit" or len(numbers) != _PCL_VIEWPOINT
            try:
                parse_field(name, text if numbers is None else numbers)
            except InvalidValueError as error:
                return str(error) if meant else None
    return None


def names_up(comment: str) -> bool:
    """True if a PLY comment states the up axis."""
    return named_up(comment) is not None


def named_up(comment: str) -> str | None:
    """Returns the up axis that a PLY comment states, such as `-y`; None if the comment states no axis.

    `Vertical axis: y` and its vectors have the meaning that Brush gives them.
    """
    text = comment.strip().rstrip(".;, ")
    if _VERTICAL_Y.fullmatch(text):
        return "-y"
    match = _UP.fullmatch(text)
    if match is None:
        return None
    axis = _axis((match[1] or match[2]).strip())
    vector = _VERTICAL_VECTOR.fullmatch(text)
    numbers = None if vector is None else _numbers(vector[1])
    if axis is None or numbers is None or sorted(map(abs, numbers)) == [0, 0, 1]:
        return axis
    return {"z": "-z", "-z": "z", "y": "y", "-y": "-y"}.get(axis)


def _axis(text: str) -> str | None:
    """Returns the name of a signed coordinate axis, such as `z` or `-y`.

    Args:
        text: Name of an axis, such as `+Z`, or the three numbers of a vector roughly along an axis.

    Returns:
        The name; None for any other text.
    """
    if axis := _AXIS.fullmatch(text):
        return f"{axis[1].replace('+', '')}{axis[2].lower()}"
    vector = _numbers(text)
    if vector is None or len(vector) != 3 or not 0 < math.hypot(*vector) < math.inf:
        return None
    largest = max(map(abs, vector))
    if largest < _MIN_UP_SHARE * math.hypot(*vector):
        return None
    index = [abs(value) for value in vector].index(largest)
    return ("-" if vector[index] < 0 else "") + "xyz"[index]


def metadata_comments(metadata: SceneMetadata) -> list[str]:
    """Returns one PLY comment per known field of the metadata."""
    fields = metadata_to_json(metadata)
    return [f"{name}: {_text(value)}" for name, value in fields.items()]


def _text(value: object) -> str:
    if isinstance(value, list):
        return " ".join(repr(number) for number in value)
    return str(value).replace("end_header", "end header")  # simple readers search for the word


def _value(name: str, text: str) -> object:
    if name == "up":
        return _axis(text)
    return _numbers(text) if name in ("view", "orbit") else text


def _numbers(text: str) -> list[float] | None:
    try:
        return [float(word) for word in re.split(r"[\s,]+", text.strip("[]() "))]
    except ValueError:
        return None
