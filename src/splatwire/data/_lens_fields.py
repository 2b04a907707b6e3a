"""Detects unsupported lenses and projections by the names of the fields in camera files."""

import math
import re
from collections.abc import Collection, Mapping

_KIND = re.compile(
    r"model|(?:is[-_]?)?(?:cam(?:era)?|sensor|lens|optics?|projection|distortion)"
    r"(?:[-_]?(?:type|model|kind|mode|geometry|projection|lens|distortion)){0,2}"
    r"|(?:image|photo)[-_]?(?:type|model|kind|mode|geometry|projection|lens)",
    re.I,
)
"""Pattern of the names of fields whose value names a lens or projection."""
_NAMED = re.compile(
    r"(?:is[-_]?|use[-_]?)?(?:fish[-_]?eye|equirect(?:angular)?|pano|panorama|panoramic|spherical|omnidirectional"
    r"|ortho(?:graphic)?|cube[-_]?map|cylindrical|360|vr[-_]?180)",
    re.I,
)
"""Pattern of the names of flags for a lens or projection, such as `is_fisheye`."""
_WIDE = re.compile(
    r"fish[-_ ]?eye|equirect|panoram|\bpano\b|spherical|omnidi|lat[-_ ]?long|\bortho\b|ortho[-_ ]?(?:gra|photo)"
    r"|cube[-_ ]?map|cylindric"
    r"|equi[-_ ]?(?:distan|solid)|stereograph|kannala|\bkb[-_ ]?[48]\b|f[-_ ]?theta|double[-_ ]?sphere"
    r"|\beucm\b|\bmei\b",
    re.I,
)
"""Pattern of lenses and projections that pinhole photos do not have."""
_TERMS = re.compile(
    r"k[1-9]|p[12]|s[1-4]|xi|b[12]|skew\w*|sk[-_][xy]|shear"
    r"|(?:\w+[-_])?(?:distortions?|dist(?=[-_]?c))(?:[-_]?(?:coef\w*|params?|parameters))?",
    re.I,
)
"""Pattern of names of distortion and skew parameters."""

_FIELD_OF_VIEW = re.compile(
    r"camera[-_]angle[-_]([xy])|(?:cam(?:era)?[-_]?)?([xyhvd]?)[-_]?fov[-_]?([xyhvd]?)(?:[-_]?(?:deg|rad)\w*)?"
    r"|field[-_]of[-_]view",
    re.I,
)
"""Pattern of names of fields with an angle of view; a letter names its axis."""
_SAME_ANGLE = 0.01
"""Largest relative difference between a focal length in pixels and the same focal length given as an angle of view."""
_BLENDER_SENSOR = 36 / 24
"""Ratio of the sides of Blender's sensor. The angle along its other side is independent of the shape of pictures."""

_CONVENTION = re.compile(
    r"convention|(?:camera|pose|axis|axes|coord\w*|world)[-_ ]?(?:convention|system|frame|space)?", re.I
)
"""Names of fields that may state other axes of the poses."""
_BARE = ("camera", "pose", "world")
"""Names of such fields that may also name a device or a place. A field with one of these names states axes only if its
text names axes."""
_AXES = re.compile(
    r"open[-_ ]?(?:cv|gl)|colmap|blender|nerf|ngp|arkit|pytorch3d|w2c|c2w|\bcv\b|\bgl\b|\b[rlfbud]{3}\b"
    r"|[xyz][-_ ]?(?:up|down)|world[-_ ]?(?:to|2)|(?:to|2)[-_ ]?world|(?:right|left)[-_ ]?hand",
    re.I,
)
"""Pattern of statements about axes."""


def states_axes(name: str, value: object) -> bool:
    """True if a JSON field of a cameras file probably names the camera axes or the direction of the pose matrices.

    Args:
        name: Name of the field.
        value: Value of the field.
    """
    if not isinstance(value, str) or not _CONVENTION.fullmatch(name):
        return False
    return name.lower() not in _BARE or _AXES.search(value) is not None


def contradicting_angle(values: Mapping[str, object], focals: tuple[float, float], size: tuple[int, int]) -> str | None:
    """Finds an angle of view that contradicts the focal lengths of a camera, and describes it for an error message.

    Args:
        values: Fields of the camera.
        focals: Focal lengths along x and y, pixels.
        size: Width and height of the picture, pixels.

    Returns:
        The description; None if there is no contradiction.
    """
    if not min(focals) > 0:
        return None  # reported elsewhere
    ratios = dict(zip("xy", (side / 2 / focal for side, focal in zip(size, focals, strict=True)), strict=True))
    ratios |= {"d": math.hypot(*ratios.values()), "h": ratios["x"], "v": ratios["y"]}
    for key, value in values.items():
        named = _FIELD_OF_VIEW.fullmatch(key)
        if named is None or isinstance(value, bool) or not isinstance(value, int | float) or value == 0:
            continue
        if key == "camera_angle_y" and _has_redundant_vertical_angle(values, focals):
            continue
        angle = value if abs(value) < math.pi else math.radians(value)
        # an angle without an axis may be horizontal, vertical or diagonal
        axis = "".join(letter for letter in named.groups() if letter).lower() or "xyd"
        allowed = [ratios[letter] for letter in axis]
        if key == "camera_angle_y" and is_sensor_angle(values):
            allowed += [ratios["x"] / _BLENDER_SENSOR, ratios["x"] * _BLENDER_SENSOR]
        if not 0 < angle < math.pi or not any(
            math.isclose(math.tan(angle / 2), ratio, rel_tol=_SAME_ANGLE) for ratio in allowed
        ):
            return (
                f"has a '{key}' of {value:g}, but focal lengths of {focals[0]:g} and {focals[1]:g} pixels in a picture "
                f"of {size[0]} x {size[1]}"
            )
    return None


def _has_redundant_vertical_angle(values: Mapping[str, object], focals: tuple[float, float]) -> bool:
    """True if a camera states the horizontal angle of view and both focal lengths, and these focal lengths are equal.

    The vertical angle of view is then superfluous. Some programs write a wrong one, which can be ignored.

    Args:
        values: Fields of the camera.
        focals: Focal lengths along x and y, pixels.
    """
    # BlenderNeRF writes these with an angle along y that is computed for a sensor of another shape
    stated = {"fl_x", "fl_y", "camera_angle_x"} <= values.keys()
    return stated and math.isclose(*focals, rel_tol=_SAME_ANGLE)


def is_sensor_angle(values: Mapping[str, object]) -> bool:
    """True if the two angles of view of a camera have the aspect ratio of Blender's sensor.

    Such angles probably describe the sensor, not the picture. The vertical angle must then be ignored.

    Args:
        values: Fields of the camera; angles in radians.
    """
    x, y = values.get("camera_angle_x"), values.get("camera_angle_y")
    if not (isinstance(x, int | float) and isinstance(y, int | float) and min(x, y) > 0 and max(x, y) < math.pi):
        return False
    ratio = math.tan(x / 2) / math.tan(y / 2)
    return any(math.isclose(ratio, sensor, rel_tol=1e-3) for sensor in (_BLENDER_SENSOR, 1 / _BLENDER_SENSOR))


def unread_lens_fields(values: Mapping[str, object], used_fields: Collection[str] = ()) -> list[str]:
    """Returns the names of unused fields that describe lens distortion or a lens other than a pinhole.

    Args:
        values: Fields of a camera or of a whole camera file; may contain objects with further fields.
        used_fields: Names of fields that the caller uses; they are skipped.
    """
    return [name for name, value in values.items() if name not in used_fields and _contains_lens(name, value)]


def _contains_lens(name: str, value: object) -> bool:
    """True if a JSON field, or a member of it, probably describes a lens with distortion."""
    objects = [part for part in (value if isinstance(value, list) else [value]) if isinstance(part, dict)]
    inner = [(word, part) for fields in objects for word, part in fields.items()]
    return _states_lens(name, value) or any(
        _states_lens(word, part) or _states_lens(f"{name}_{word}", part) for word, part in inner
    )


def _states_lens(name: str, value: object) -> bool:
    if isinstance(value, str):
        return bool(_KIND.fullmatch(name) and _WIDE.search(value))
    if _NAMED.fullmatch(name):
        return isinstance(value, bool | int | float) and bool(value)
    return bool(_TERMS.fullmatch(name)) and _has_numbers(value)


def _has_numbers(value: object) -> bool:
    """True for a number other than 0, and for a list or an object with at least one such number."""
    if isinstance(value, dict):
        value = list(value.values())
    parts = value if isinstance(value, list) else [value]
    rows = [number for part in parts if isinstance(part, list) for number in part]
    return any(isinstance(one, int | float) and not isinstance(one, bool) and one != 0 for one in [*parts, *rows])
