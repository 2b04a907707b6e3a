"""Metadata of a scene: title, author, license, up axis and initial view."""

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from splatwire.arguments import CheckedFields, checked
from splatwire.errors import InvalidValueError, shown
from splatwire.types.origin import Origin

MAX_TEXT = 500
"""Maximum number of characters of a text; longer texts are truncated."""
UP_AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Possible up axes, in the coordinate system of a 3DGS PLY; `-y` is up in most scenes."""
_MAX_COORDINATE = 1e12
_MIN_LENGTH = 1e-6
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class StartView(CheckedFields):
    """Initial view of a scene.

    Attributes:
        eye: Position of the camera, world coordinates relative to the scene's origin.
        target: The point that the camera looks at.
        up: Up direction of the camera.

    Raises:
        InvalidValueError: If a field is not three finite numbers.
    """

    eye: Vector
    target: Vector
    up: Vector

    def numbers(self) -> tuple[float, ...]:
        """Returns eye, target and up as nine numbers."""
        return (*self.eye, *self.target, *self.up)

    @staticmethod
    def of(values: object) -> "StartView | None":
        """Builds a view from nine numbers (eye, target, up), or returns None for invalid numbers."""
        if not isinstance(values, Sequence) or len(values) != 9 or not all(map(_is_coordinate, values)):
            return None
        numbers = [float(value) for value in values]
        view = StartView(_vector(numbers[:3]), _vector(numbers[3:6]), _vector(numbers[6:]))
        apart, length = math.dist(view.eye, view.target), math.hypot(*view.up)
        return view if apart > 0 and length > _MIN_LENGTH else None


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
        """Converts the initial view from coordinates relative to `before` to coordinates relative to `after`."""
        if self.view is None or before == after:
            return self
        eye, target = (
            _vector([value + b - a for value, b, a in zip(point, before, after, strict=True)])
            for point in (self.view.eye, self.view.target)
        )
        return replace(self, view=replace(self.view, eye=eye, target=target))

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
    for name in {"title", "author", "license"} & set(fields):
        fields[name] = clean_text(fields[name])
    if metadata.view is not None:
        fields["view"] = list(metadata.view.numbers())
    if metadata.orbit is not None:
        fields["orbit"] = list(metadata.orbit)
    return fields


def metadata_from_json(content: object) -> SceneMetadata:
    """Parses the result of `metadata_to_json`; fields of a wrong type are ignored."""
    if not isinstance(content, dict):
        return NO_METADATA
    up, orbit = content.get("up"), content.get("orbit")
    return SceneMetadata(
        title=clean_text(content.get("title")),
        author=clean_text(content.get("author")),
        license=clean_text(content.get("license")),
        up=up if isinstance(up, str) and up in UP_AXES else None,
        view=StartView.of(content.get("view")),
        orbit=_vector(orbit) if isinstance(orbit, Sequence) and _are_three(orbit) else None,
    )


def clean_text(value: object) -> str:
    """Returns a text as one line without control characters, at most `MAX_TEXT` long.

    Other types give an empty text.
    """
    if not isinstance(value, str):
        return ""
    text = "".join(" " if unicodedata.category(char) in ("Cc", "Zl", "Zp") else char for char in value[: 4 * MAX_TEXT])
    text = "".join(char for char in text if unicodedata.category(char) not in ("Cf", "Cs", "Co", "Cn"))
    return " ".join(text.split())[:MAX_TEXT].strip()


def _are_three(values: Sequence[object]) -> bool:
    return len(values) == 3 and all(map(_is_coordinate, values))


def _is_coordinate(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MAX_COORDINATE


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
