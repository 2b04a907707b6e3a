"""Metadata of a scene: title, author, license, up axis, initial view and orbit limits."""

import logging
import math
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from splatwire.arguments import CheckedFields, checked
from splatwire.errors import InvalidValueError, shown
from splatwire.types.origin import Origin, describe_origin

LOG = logging.getLogger(__name__)
MAX_TEXT = 500
"""Maximum number of characters of a text; longer texts are truncated."""
_TEXTS = ("title", "author", "license")
"""Names of the fields that are texts."""
UP_AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Possible up axes, in the coordinate system of a 3DGS PLY; `-y` is up in most scenes."""
_MAX_COORDINATE = 1e12
_MIN_LENGTH = 1e-6
_JOINERS = "\u200c\u200d"
"""Invisible characters that Persian, Indic scripts and emoji need between visible ones."""
_LOOSE_JOINERS = re.compile(f"(?<!\\S)[{_JOINERS}]+|[{_JOINERS}]+(?!\\S)|(?<=[{_JOINERS}])[{_JOINERS}]+")
"""Pattern of such characters that are not between two visible ones."""
_FLAGS = re.compile("(\U0001f3f4[\U000e0030-\U000e0039\U000e0061-\U000e007a]{3,6}\U000e007f)")
"""Pattern of flags such as that of Scotland: a black flag, and the code of the region in invisible tag characters."""
_MAX_READ = 1 << 16
"""Maximum number of characters of a text that are examined, invisible ones included."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class StartView(CheckedFields):
    """Initial view of a scene.

    Attributes:
        eye: Position of the camera, world coordinates relative to the scene's origin.
        target: Point that the camera looks at; must differ from `eye`.
        up: Up direction of the camera, of any length above 1e-6. It may be parallel to the direction of view: viewers
            then tilt the view slightly.

    Raises:
        InvalidValueError: If a field is not three finite numbers, or violates a condition above.
    """

    eye: Vector
    target: Vector
    up: Vector

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(map(_is_coordinate, self.numbers())):
            raise InvalidValueError(f"StartView: a coordinate is beyond {_MAX_COORDINATE:g}")
        if not math.dist(self.eye, self.target) > 0:
            raise InvalidValueError(f"StartView: eye and target are the same point, {self.eye}")
        if not math.hypot(*self.up) > _MIN_LENGTH:
            raise InvalidValueError(f"StartView: the up direction {self.up} has no length")

    def numbers(self) -> tuple[float, ...]:
        """Returns eye, target and up as nine numbers."""
        return (*self.eye, *self.target, *self.up)

    @staticmethod
    def of(values: object) -> "StartView":
        """Builds a view from nine numbers (eye, target, up).

        Raises:
            InvalidValueError: If they are not nine finite numbers, or not a view.
        """
        numbers = _coordinates(values, 9, "nine numbers (eye, target, up)")
        return StartView(_vector(numbers[:3]), _vector(numbers[3:6]), _vector(numbers[6:]))


@dataclass(frozen=True)
class SceneMetadata(CheckedFields):
    """Metadata of a scene; a field without information is empty or None.

    Attributes:
        title: Name of the scene.
        author: Name of its author.
        license: Its license, or a copyright statement.
        up: Up axis, one of `UP_AXES`.
        view: The initial view.
        orbit: Limits of an orbiting camera: minimum and maximum elevation in radians, minimum radius in world units.

    Raises:
        InvalidValueError: If a field has a wrong type, or `up` is none of `UP_AXES`.
    """

    title: str = ""
    author: str = ""
    license: str = ""
    up: str | None = None
    view: StartView | None = None
    orbit: Vector | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.up is not None and self.up not in UP_AXES:
            raise InvalidValueError(f"SceneMetadata.up: expected one of {', '.join(UP_AXES)}, not {shown(self.up)}")

    def known(self) -> list[str]:
        """Returns the names of the metadata fields that are set."""
        return [field.name for field in fields(self) if getattr(self, field.name) not in ("", None)]

    def moved_origin(self, before: Origin, after: Origin) -> "SceneMetadata":
        """Converts the initial view from coordinates relative to `before` to coordinates relative to `after`.

        If the converted numbers are too large, or eye and target coincide, the view is left out with a warning.
        """
        if self.view is None or before == after:
            return self
        eye, target = (
            _vector([value + b - a for value, b, a in zip(point, before, after, strict=True)])
            for point in (self.view.eye, self.view.target)
        )
        try:
            return replace(self, view=replace(self.view, eye=eye, target=target))
        except InvalidValueError as error:
            LOG.warning("the initial view is left out: relative to the origin %s: %s", describe_origin(after), error)
            return replace(self, view=None)

    @checked
    def over(self, other: "SceneMetadata") -> "SceneMetadata":
        """Returns this metadata, with empty fields filled from `other`."""
        stated = self.known()
        return SceneMetadata(**{f.name: getattr(self if f.name in stated else other, f.name) for f in fields(self)})


NO_METADATA = SceneMetadata()
"""Metadata with all fields empty."""


def metadata_to_json(metadata: SceneMetadata) -> dict[str, Any]:
    """Returns a JSON object with the fields of the metadata that have a value."""
    fields: dict[str, Any] = {name: getattr(metadata, name) for name in metadata.known()}
    warn_of_long_texts(fields, "the scene")
    for name in set(_TEXTS) & set(fields):
        fields[name] = clean_text(fields[name])
    if metadata.view is not None:
        fields["view"] = list(metadata.view.numbers())
    if metadata.orbit is not None:
        fields["orbit"] = list(metadata.orbit)
    return fields


def metadata_from_json(content: object, source: object = None) -> SceneMetadata:
    """Parses the result of `metadata_to_json`; invalid fields are left out.

    Args:
        content: The JSON object.
        source: Name of the file, for a warning about each field that is left out; None for no warning.
    """
    if not isinstance(content, dict):
        if content is not None and source is not None:
            LOG.warning("%s: its metadata are %s, not a JSON object: they are left out", source, shown(content))
        return NO_METADATA
    if source is not None:
        warn_of_long_texts(content, source)
    fields: dict[str, Any] = {}
    for name in _PARSERS:
        if content.get(name) is None:
            continue
        try:
            fields[name] = parse_field(name, content[name])
        except InvalidValueError as error:
            if source is not None:
                LOG.warning("%s: '%s' of its metadata is left out: %s", source, name, error)
    return SceneMetadata(**fields)


def warn_of_long_texts(content: Mapping[str, object], source: object) -> None:
    """Logs a warning about each text of metadata that will be cut.

    Characters that `clean_text` leaves out do not count.

    Args:
        content: Metadata as a JSON object.
        source: Name of their source, for the message.
    """
    for name in _TEXTS:
        if _is_cut(content.get(name)):
            LOG.warning("%s: '%s' of its metadata is longer than %d characters and cut", source, name, MAX_TEXT)


def parse_field(name: str, value: object) -> Any:
    """Parses the JSON value of a field of `SceneMetadata`.

    Raises:
        InvalidValueError: If the value is invalid.
    """
    return _PARSERS[name](value)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise InvalidValueError(f"expected text, not {shown(value)}")
    return clean_text(value)


def _up(value: object) -> str:
    if not (isinstance(value, str) and value in UP_AXES):
        raise InvalidValueError(f"expected one of {', '.join(UP_AXES)}, not {shown(value)}")
    return value


def _orbit(value: object) -> Vector:
    return _vector(_coordinates(value, 3, "three numbers"))


def _coordinates(values: object, count: int, expected: str) -> list[float]:
    """Checks and converts a list of finite numbers.

    Args:
        values: The list.
        count: Length of the list.
        expected: Description of the list for the message.

    Raises:
        InvalidValueError: If it is not such a list, or a number is not finite or beyond the limit of coordinates.
    """
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise InvalidValueError(f"expected {expected}, not {shown(values)}")
    if len(values) != count:
        raise InvalidValueError(f"expected {expected}, not {len(values)}")
    if wrong := [value for value in values if not _is_coordinate(value)]:
        raise InvalidValueError(f"expected {expected} within {_MAX_COORDINATE:g}, not {shown(wrong[0])}")
    return [float(value) for value in values]


_PARSERS: dict[str, Callable[[Any], Any]] = {
    "title": _text, "author": _text, "license": _text, "up": _up, "view": StartView.of, "orbit": _orbit,
}  # fmt: skip
"""Parser of each field of metadata."""


def clean_text(value: object, max_length: int = MAX_TEXT) -> str:
    """Returns a text as one line without control characters, at most `max_length` long.

    Other types give an empty text.
    """
    if not isinstance(value, str):
        return ""
    text, end = _one_line(value), max_length
    for flag in _FLAGS.finditer(text):
        if flag.start() < end < flag.end():
            end = flag.start()  # a part of a flag would be another flag
    return text[:end].strip(f" {_JOINERS}")


def _one_line(value: str) -> str:
    """Returns the first `_MAX_READ` characters of a text as one line without control and invisible characters."""
    parts = _FLAGS.split(value[:_MAX_READ])  # flags are the parts with odd indices
    text = "".join(part if index % 2 else _without_invisible(part) for index, part in enumerate(parts))
    return " ".join(_LOOSE_JOINERS.sub("", text).split())


def _without_invisible(text: str) -> str:
    spaced = "".join(" " if unicodedata.category(char) in ("Cc", "Zl", "Zp") else char for char in text)
    return "".join(char for char in spaced if char in _JOINERS or not _is_invisible(char))


def _is_cut(value: object) -> bool:
    """True if `clean_text` leaves out the end of a text."""
    return isinstance(value, str) and (len(value) > _MAX_READ or len(_one_line(value)) > MAX_TEXT)


def _is_invisible(char: str) -> bool:
    """True for characters that are invisible or have no meaning; some of them can reorder or hide others."""
    code = ord(char)
    return unicodedata.category(char) in ("Cf", "Cs", "Co") or code & 0xFFFE == 0xFFFE or 0xFDD0 <= code <= 0xFDEF


def _is_coordinate(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MAX_COORDINATE


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
