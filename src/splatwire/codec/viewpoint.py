"""Where a scene is looked at first: named sections of side information, where cameras are known and where not."""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError
from splatwire.ops.arrays import to_numpy
from splatwire.scene import Cameras

SECTION = "viewpoint"
"""Name of the section."""
MIN_UP, MAX_UP = 0.5, 2.0
"""Bounds of the length of the upward direction of a viewpoint."""
UP_SECTION = "up"
"""Name of the section that says only which axis is up: its name as text, `y`, `-z`, ...; `-y` where it is absent."""
AXES = (b"x", b"-x", b"y", b"-y", b"z", b"-z")
EXTENT_SECTION = "extent"
"""Name of the section that says where a clip goes: a ball around each frame, middle and radius as `f32`."""


def up_sections(axis: str) -> dict[str, bytes]:
    """The section that says which axis is up, by its name; none for `-y`."""
    return {} if axis == "-y" else {UP_SECTION: axis.encode()}


def up_axis(sections: Mapping[str, bytes]) -> str:
    """The name of the axis that is up.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If they name no axis.
    """
    name = sections.get(UP_SECTION, b"-y")
    if name not in AXES:
        raise BitstreamError(f"section '{UP_SECTION}': {name[:8]!r} is no axis that can be up")
    return name.decode()


def extent_section(middle: Iterable[float], radius: float) -> bytes:
    """The section that says that a clip stays within a ball, world units."""
    writer = ByteWriter()
    for value in (*middle, radius):
        writer.f32(float(value))
    return writer.bytes()


def read_extent(sections: Mapping[str, bytes]) -> tuple[tuple[float, float, float], float] | None:
    """Middle and radius of the ball that a clip stays within; None where nobody says it.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If there is no such ball.
    """
    if EXTENT_SECTION not in sections:
        return None
    reader = ByteReader(sections[EXTENT_SECTION], f"section '{EXTENT_SECTION}'")
    x, y, z, radius = (reader.f32() for _ in range(4))
    reader.finish()
    if not (all(map(math.isfinite, (x, y, z, radius))) and radius > 0):
        raise BitstreamError(f"section '{EXTENT_SECTION}': an impossible ball")
    return (x, y, z), radius


def check_viewpoint(sections: Mapping[str, bytes]) -> None:
    """Checks the sections that say from where a scene is looked at, as the page does when it opens a stream.

    Args:
        sections: Named sections of a stream.

    Raises:
        BitstreamError: If they name no axis, no ball, or an eye that is where it looks.
    """
    up_axis(sections)
    read_extent(sections)
    if SECTION not in sections:
        return
    reader = ByteReader(sections[SECTION], f"section '{SECTION}'")
    eye, target, up = (tuple(reader.f32() for _ in range(3)) for _ in range(3))
    reader.finish()
    apart, length = math.hypot(*(a - b for a, b in zip(eye, target, strict=True))), math.hypot(*up)
    if not (0 < apart < math.inf and MIN_UP < length < MAX_UP):
        raise BitstreamError(f"section '{SECTION}': an impossible viewpoint")


def viewpoint_section(cameras: Cameras) -> bytes:
    """The section that lets a receiver begin where the first camera is.

    Args:
        cameras: The scene's cameras. The point to turn around is the one nearest to all of their axes (least squares;
            half of the way to the other cameras' mean where the axes do not meet in front of the first one).

    Returns:
        Nine `f32`: the eye, the point that it looks at, and the direction that is up there, the mean of all cameras'.
    """
    centers, turns = (to_numpy(a).astype(np.float64) for a in (cameras.centers, cameras.viewmats[:, :3, :3]))
    ahead, up = turns[:, 2], -turns[:, 1].mean(axis=0)
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    # a little of the identity: parallel axes are near all points alike
    system = across.sum(axis=0) + 1e-6 * len(centers) * np.eye(3)
    meeting = np.linalg.inv(system) @ ((across @ centers[:, :, None]).sum(axis=0)[:, 0] + 1e-6 * centers.sum(axis=0))
    depth = float((meeting - centers[0]) @ ahead[0])
    least = float(np.linalg.norm(centers - centers[0], axis=1).mean()) / 2
    target = centers[0] + max(depth, least, 1e-3) * ahead[0]
    writer = ByteWriter()
    for value in (*centers[0].tolist(), *target.tolist(), *(up / max(float(np.linalg.norm(up)), 1e-9)).tolist()):
        writer.f32(value)
    return writer.bytes()
