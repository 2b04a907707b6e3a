"""Image encoding: pixels, PNG files, and JPEG data URLs."""

import base64
import io
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from splatwire.ops.arrays import to_numpy

ERROR_GAIN = 4


def to_pixels(image: Float[Any, "H W 3"]) -> np.ndarray:
    """Rounds RGB in [0, 1] to bytes."""
    return (np.clip(to_numpy(image), 0, 1) * 255 + 0.5).astype(np.uint8)


def error_map(pixels: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Returns the error of every pixel: the largest channel difference times `ERROR_GAIN`; uint8, (H, W)."""
    error = np.abs(pixels.astype(np.int16) - reference.astype(np.int16)).max(axis=2)
    return np.clip(error * ERROR_GAIN, 0, 255).astype(np.uint8)


def png_bytes(pixels: np.ndarray) -> bytes:
    """Encodes RGB, uint8, as PNG."""
    # The compression level favours speed: 10 % smaller files would take three times as long.
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def png_pixels(data: bytes) -> np.ndarray:
    """Decodes a PNG file to RGB, uint8."""
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def jpeg(pixels: np.ndarray, quality: int = 88) -> str:
    """Encodes RGB or grey, uint8, as a JPEG data URL."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=quality)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
