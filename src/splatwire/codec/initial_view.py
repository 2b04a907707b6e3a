"""Initial view, upward axis and extent of a scene: named sections of the side information."""

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.ops.arrays import to_numpy

if TYPE_CHECKING:
    from splatwire.types import Cameras

SECTION = "viewpoint"
"""Name of the section."""
MIN_UP, MAX_UP = 0.5, 2.0
"""Bounds of the length of the upward direction of an initial view."""
UP_SECTION = "up"
"""Name of the section with the upward axis alone: text such as `y` or `-z`. Without it, `-y` is up."""
AXES = (b"x", b"-x", b"y", b"-y", b"z", b"-z")
EXTENT_SECTION = "extent"
"""Name of the section with a sequence's bounding sphere over all frames: centre and radius as `f32`."""


class InitialView(NamedTuple):
    """Initial view of a scene, relative to its origin.

    Attributes:
        eye: Position of the camera (3), world units.
        target: Point that the camera looks at and orbits around (3), world units.
        up: Direction that points up in the picture (3).
    """

    eye: tuple[float, ...]
    target: tuple[float, ...]
    up: tuple[float, ...]


def up_sections(axis: str) -> dict[str, bytes]:
    """Returns the upward axis as named sections of the side information: one section, or none for the default `-y`."""
    return {} if axis == "-y" else {UP_SECTION: axis.encode()}


def up_axis(sections: Mapping[str, bytes]) -> str:
    """Reads the upward axis of a scene: `x`, `y` or `z`, with `-` for the negative direction; `-y` if absent.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If the section does not contain the name of an axis.
    """
    name = sections.get(UP_SECTION, b"-y")
    if name not in AXES:
        raise BitstreamError(f"section '{UP_SECTION}': {name[:8]!r} is no axis that can be up")
    return name.decode()


def extent_section(middle: Iterable[float], radius: float) -> bytes:
    """Serialises a sequence's bounding sphere, world units."""
    writer = ByteWriter()
    for value in (*middle, radius):
        writer.f32(float(value))
    return writer.bytes()


def read_extent(sections: Mapping[str, bytes]) -> tuple[tuple[float, float, float], float] | None:
    """Returns centre and radius of a sequence's bounding sphere; None if the section is absent.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If the numbers do not form a sphere.
    """
    if EXTENT_SECTION not in sections:
        return None
    reader = ByteReader(sections[EXTENT_SECTION], f"section '{EXTENT_SECTION}'")
    x, y, z, radius = (reader.f32() for _ in range(4))
    reader.finish()
    if not (all(map(math.isfinite, (x, y, z, radius))) and radius > 0):
        raise BitstreamError(f"section '{EXTENT_SECTION}': an impossible ball")
    return (x, y, z), radius


def check_view_sections(sections: Mapping[str, bytes]) -> None:
    """Checks the sections with initial view, up axis and extent.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If the axis, the sphere or the view is invalid, for example if eye and target coincide.
    """
    # The web page has the same rules.
    up_axis(sections)
    read_extent(sections)
    read_initial_view(sections)


def read_initial_view(sections: Mapping[str, bytes]) -> "InitialView | None":
    """Returns the initial view of a scene; None if the section is absent.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If the view is invalid, for example if eye and target coincide.
    """
    if SECTION not in sections:
        return None
    reader = ByteReader(sections[SECTION], f"section '{SECTION}'")
    eye, target, up = (tuple(reader.f32() for _ in range(3)) for _ in range(3))
    reader.finish()
    distance, length = math.hypot(*(a - b for a, b in zip(eye, target, strict=True))), math.hypot(*up)
    if not (0 < distance < math.inf and MIN_UP < length < MAX_UP):
        raise BitstreamError(f"section '{SECTION}': an impossible viewpoint")
    return InitialView(eye, target, up)


def initial_view_section(cameras: "Cameras") -> bytes:
    """Serialises the initial view of a scene, which is the view of the first camera.

    Args:
        cameras: The scene's cameras.

    Returns:
        Nine `f32`: position of the camera, point to orbit around, and mean upward direction of all cameras.
    """
    # The point to orbit around is on the viewing axis of the first camera, at the depth where the axes of all cameras
    # nearly meet.
    centers, turns = (to_numpy(a).astype(np.float64) for a in (cameras.centers, cameras.viewmats[:, :3, :3]))
    ahead, up = turns[:, 2], -turns[:, 1].mean(axis=0)
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    # The point nearest to all axes (least squares); regularised, because parallel axes determine no nearest point.
    system = across.sum(axis=0) + 1e-6 * len(centers) * np.eye(3)
    meeting = np.linalg.inv(system) @ ((across @ centers[:, :, None]).sum(axis=0)[:, 0] + 1e-6 * centers.sum(axis=0))
    depth = float((meeting - centers[0]) @ ahead[0])
    # A lower bound, in case the axes do not meet in front of the camera.
    least = float(np.linalg.norm(centers - centers[0], axis=1).mean()) / 2
    target = centers[0] + max(depth, least, 1e-3) * ahead[0]
    writer = ByteWriter()
    for value in (*centers[0].tolist(), *target.tolist(), *(up / max(float(np.linalg.norm(up)), 1e-9)).tolist()):
        writer.f32(value)
    return writer.bytes()
