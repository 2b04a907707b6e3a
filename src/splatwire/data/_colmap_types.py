"""Records of a COLMAP reconstruction, as both file formats hold them."""

from dataclasses import dataclass

MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
)
"""Camera models by number: name and count of parameters."""


@dataclass(frozen=True)
class RawCamera:
    """One line of `cameras`.

    Attributes:
        camera_id: Its number.
        model: Name of the model.
        width: Image width in pixels.
        height: Image height in pixels.
        parameters: As many as the model has.
    """

    camera_id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class RawImage:
    """One image of `images`, without its 2D points.

    Attributes:
        name: File name.
        camera_id: Its camera.
        quaternion: World-to-camera rotation, (w, x, y, z).
        translation: World-to-camera translation.
    """

    name: str
    camera_id: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
