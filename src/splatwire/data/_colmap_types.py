"""Records of a COLMAP reconstruction, common to the binary and the text format."""

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
"""Name and number of parameters of each camera model, by COLMAP's model number."""


@dataclass(frozen=True)
class RawCamera:
    """A camera of a COLMAP reconstruction, as stored in `cameras.bin` or `cameras.txt`.

    Attributes:
        camera_id: Identifier of the camera.
        model: Name of the camera model.
        width: Image width in pixels.
        height: Image height in pixels.
        parameters: Parameters of the camera model, in COLMAP's order.
    """

    camera_id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class RawImage:
    """An image of a COLMAP reconstruction, as stored in `images.bin` or `images.txt`, without its 2D points.

    Attributes:
        name: File name.
        camera_id: Identifier of the camera that took the image.
        quaternion: World-to-camera rotation, (w, x, y, z).
        translation: World-to-camera translation.
    """

    name: str
    camera_id: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
