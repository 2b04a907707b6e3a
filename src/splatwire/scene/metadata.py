"""Metadata of a scene: title, author, license, the axis that points up, and the view that it opens with."""

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from splatwire.scene.origin import Origin

MAX_TEXT = 500
"""Characters of a text; longer ones are cut."""
UP_AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Axes that may point up, in the axes of a 3DGS PLY, in which most scenes have `-y` up."""
_MAX_COORDINATE = 1e12
_LEAST_LENGTH = 1e-6
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class StartView:
    """View that a scene opens with.

    Attributes:
        eye: Position of the camera, world coordinates relative to the scene's origin.
        target: The point that it looks at.
        up: Direction that points up there.
    """

    eye: Vector
    target: Vector
    up: Vector

    def numbers(self) -> tuple[float, ...]:
        """Returns eye, target and up one after another, nine numbers."""
        return (*self.eye, *self.target, *self.up)

    @staticmethod
    def of(values: object) -> "StartView | None":
        """Makes a view of nine numbers; None if that is none."""
        if not isinstance(values, Sequence) or len(values) != 9 or not all(map(_is_coordinate, values)):
            return None
        numbers = [float(value) for value in values]
        view = StartView(_vector(numbers[:3]), _vector(numbers[3:6]), _vector(numbers[6:]))
        apart, length = math.dist(view.eye, view.target), math.hypot(*view.up)
        return view if apart > 0 and length > _LEAST_LENGTH else None


@dataclass(frozen=True)
class SceneMetadata:
    """Metadata of a scene; what is not known is empty or None.

    Attributes:
        title: Name of the scene.
        author: Name of its author.
        license: Its license, or a statement of copyright.
        up: Axis that points up, one of `UP_AXES`.
        view: The view that it opens with.
        orbit: Limits of a camera that orbits it: least and greatest elevation in radians, least radius in world units.
    """

    title: str = ""
    author: str = ""
    license: str = ""
    up: str | None = None
    view: StartView | None = None
    orbit: Vector | None = None

    def known(self) -> list[str]:
        """Returns the names of the fields that are known."""
        return [field.name for field in fields(self) if getattr(self, field.name) not in ("", None)]

    def moved_origin(self, before: Origin, after: Origin) -> "SceneMetadata":
        """Returns the metadata of a scene with positions relative to `after`, given those relative to `before`."""
        if self.view is None or before == after:
            return self
        eye, target = (
            _vector([value + b - a for value, b, a in zip(point, before, after, strict=True)])
            for point in (self.view.eye, self.view.target)
        )
        return replace(self, view=replace(self.view, eye=eye, target=target))

    def over(self, other: "SceneMetadata") -> "SceneMetadata":
        """Returns the metadata with fields of `other` where they are not known here."""
        known = self.known()
        return SceneMetadata(**{f.name: getattr(self if f.name in known else other, f.name) for f in fields(self)})


NO_METADATA = SceneMetadata()
"""Metadata of a scene of which nothing is known."""


def metadata_to_json(metadata: SceneMetadata) -> dict[str, Any]:
    """Returns the known fields as JSON values."""
    found: dict[str, Any] = {name: getattr(metadata, name) for name in metadata.known()}
    for name in {"title", "author", "license"} & set(found):
        found[name] = clean_text(found[name])
    if metadata.view is not None:
        found["view"] = list(metadata.view.numbers())
    if metadata.orbit is not None:
        found["orbit"] = list(metadata.orbit)
    return found


def metadata_from_json(content: object) -> SceneMetadata:
    """Makes metadata of what `metadata_to_json` returned; fields of another kind are left out."""
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
    """Returns a text of one line without control characters, of at most `MAX_TEXT` characters; empty if it is none."""
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
