"""Thumbnail of a scene from a given view, or from the side that shows the most detail."""

import io
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import sections_of
from splatwire.codec import decode_stream
from splatwire.codec.initial_view import InitialView, read_initial_view
from splatwire.concealment import conceal_if_received, create_concealer
from splatwire.errors import InvalidValueError
from splatwire.evaluation.pixels import to_pixels
from splatwire.render import iterate_views
from splatwire.render.framing import framing_cameras
from splatwire.sequence.decoding import decode_frame
from splatwire.types import Cameras
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.scene import Scene

SIDES = 8
"""Number of directions around a scene among which the direction of the thumbnail is chosen."""
SIZE = (1200, 630)
"""Default width and height, pixels: those that programs show as the preview of a link."""
MAX_SIDE = 4096
"""Maximum width and height, pixels."""
SUFFIXES = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".webp": "WEBP"}
"""Formats of pictures by file name suffix."""
_TRIAL_PIXELS = 128
"""Width and height of the pictures that are compared by detail, pixels."""
_JPEG_QUALITY = 85


def thumbnail(scene: Scene, size: tuple[int, int] = SIZE, view: InitialView | None = None) -> np.ndarray:
    """Renders a thumbnail of a scene.

    Args:
        scene: The scene.
        size: Width and height, pixels.
        view: View of the thumbnail. If it is None, several views of the whole scene are compared, and the
            view with the most detail is used.

    Returns:
        The picture, uint8 (height, width, 3).

    Raises:
        InvalidValueError: If the size is out of range, or the scene is empty.
    """
    width, height = size
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise InvalidValueError(f"a thumbnail has 1 to {MAX_SIDE} pixels in each direction, not {width} x {height}")
    camera = _best_side(scene, min(size)) if view is None else _camera_at(view, min(size))
    intrinsics = camera.Ks.copy()
    intrinsics[:, 0, 2], intrinsics[:, 1, 2] = width / 2, height / 2
    (image,) = iterate_views(scene, replace(camera, Ks=intrinsics, width=width, height=height))
    return to_pixels(image)


def stream_thumbnail(stream: SceneStream, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Renders a thumbnail of a stream from the initial view that the stream declares.

    For a sequence, the first frame is rendered.

    Args:
        stream: The stream; elements of lost packets are left out.
        size: Width and height, pixels.

    Returns:
        The picture, uint8 (height, width, 3).
    """
    view = read_initial_view(sections_of(stream))
    received = decode_stream(stream)
    if stream.manifest.schema.timed:
        return thumbnail(decode_frame(received.scene, 0).scene, size, view)
    return thumbnail(conceal_if_received(received, create_concealer("drop")), size, view)


def picture_bytes(pixels: np.ndarray, suffix: str) -> bytes:
    """Encodes a picture, uint8 (height, width, 3), in the format of a file name suffix.

    Raises:
        InvalidValueError: If the suffix is not in `SUFFIXES`.
    """
    if suffix.lower() not in SUFFIXES:
        raise InvalidValueError(f"a picture is a {', '.join(SUFFIXES)} file, not '{suffix}'")
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, SUFFIXES[suffix.lower()], quality=_JPEG_QUALITY)
    return buffer.getvalue()


def check_suffix(path: Path) -> None:
    """Checks that a file name has the suffix of a picture format.

    Raises:
        InvalidValueError: If the suffix is not in `SUFFIXES`.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidValueError(f"{path}: a thumbnail is a {', '.join(SUFFIXES)} file")


def _best_side(scene: Scene, size: int) -> Cameras:
    """Returns the camera whose picture has the most detail, from several cameras around a scene."""
    # Detail is the mean difference of neighbouring pixels, measured in small pictures.
    trials = iterate_views(scene, framing_cameras(scene, SIDES, _TRIAL_PIXELS))
    best = int(np.argmax([_detail(np.asarray(image)) for image in trials]))
    return framing_cameras(scene, SIDES, size)[best]


def _detail(image: Float[np.ndarray, "H W 3"]) -> float:
    return float(np.abs(np.diff(image, axis=0)).mean() + np.abs(np.diff(image, axis=1)).mean())


def _camera_at(view: InitialView, size: int) -> Cameras:
    """Returns a square camera with a field of view of 60 degrees that has a view."""
    eye, target, up = (np.array(vector, np.float64) for vector in view)
    distance = float(np.linalg.norm(target - eye))
    ahead = (target - eye) / distance
    right = np.cross(ahead, up)
    if np.linalg.norm(right) < 1e-6:  # looks along the up direction: any horizontal axis is as good
        right = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin()])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ eye
    focal = size / 2 / math.tan(math.pi / 6)
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], np.float32)
    near = min(NEAR_DEPTH, NEAR_DEPTH * distance)
    return Cameras(pose[None].astype(np.float32), intrinsics[None], size, size, ("initial view",), near_depth=near)
