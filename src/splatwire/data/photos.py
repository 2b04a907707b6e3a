"""Loading of photos and masks as arrays."""

import struct
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageOps

from splatwire.arguments import checked
from splatwire.errors import MALFORMED, DatasetError
from splatwire.files.kinds import format_error
from splatwire.types.background import BLACK, Background

_OPAQUE_MODES = ("L", "P", "RGB")
_ALPHA_MODES = ("LA", "PA", "RGBA")
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
_FREE_PIXELS, _FREE_MASK_PIXELS = 16 << 20, 64 << 20
"""Number of pixels accepted for a photo and for a mask of any file size."""
_ORIENTATION_TAG = 0x112
_ORIENTATIONS = range(2, 9)
"""EXIF orientations that rotate or mirror."""
_SIDES_SWAPPED = range(5, 9)
"""EXIF orientations that swap width and height."""
_PIXELS_PER_BYTE = 32
"""Maximum pixels per byte of file for larger images; photos have at most 10."""


def photo_size(path: Path, *, apply_exif: bool = False) -> tuple[int, int]:
    """Returns width and height of an image file in pixels, read from the header only.

    Args:
        path: The file.
        apply_exif: True for the size after applying the EXIF orientation.

    Raises:
        DatasetError: If the file is missing or not an image.
    """
    with _open(path) as image:
        return image.size[::-1] if apply_exif and _orientation(image) in _SIDES_SWAPPED else image.size


def check_photo(path: Path) -> None:
    """Checks, from the header only, that `load_photo` reads an image of this kind.

    Raises:
        DatasetError: If the file is missing, not an image, or not 8-bit grey, palette or RGB, with or without
            alpha.
    """
    with _open(path) as image:
        _check_mode(path, image)


def _check_mode(path: Path, image: Image.Image) -> None:
    if image.mode not in _OPAQUE_MODES + _ALPHA_MODES:
        raise DatasetError(f"{path}: images in mode {image.mode} are not read; convert it to 8-bit RGB")


def has_exif_rotation(path: Path) -> bool:
    """True if an image has an EXIF orientation that rotates or mirrors it.

    Raises:
        DatasetError: If the file is missing or not an image.
    """
    with _open(path) as image:
        return _orientation(image) in _ORIENTATIONS


def _orientation(image: Image.Image) -> object:
    if image.format == "PNG" and "exif" not in image.info:
        return None  # Pillow would decode the whole image to search for a late EXIF chunk
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow prints one for damaged metadata
            return image.getexif().get(_ORIENTATION_TAG)
    except (OSError, SyntaxError, struct.error, *MALFORMED):
        return None  # unreadable metadata has no effect in other programs either


@checked
def load_photo(
    path: Path, size: tuple[int, int] | None = None, background: Background = BLACK, *, apply_exif: bool = False
) -> Float[np.ndarray, "H W 3"]:
    """Loads an image as RGB in [0, 1].

    Args:
        path: The file: 8 bits per channel, grey, palette or RGB, with or without alpha.
        size: Width and height to resize to (bicubic, on 8-bit values, as in HAC++); None keeps the size.
        background: RGB visible where alpha is below 1.
        apply_exif: True to apply the EXIF orientation before resizing.

    Raises:
        DatasetError: If the file is missing or not such an image.
    """
    with _open(path) as image:
        has_alpha = image.mode in _ALPHA_MODES or "transparency" in image.info
        _check_mode(path, image)
        _check_pixels(path, image, _FREE_PIXELS)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # as in `_orientation`
                rotated = ImageOps.exif_transpose(image) if apply_exif else image
            whole = rotated.convert("RGBA" if has_alpha else "RGB")
        except (OSError, SyntaxError, struct.error, *MALFORMED) as error:
            raise DatasetError(f"{path}: the image is damaged: {error}") from error
    if not has_alpha and size not in (None, whole.size):
        whole = whole.resize(size, Image.Resampling.BICUBIC)
    pixels: np.ndarray = np.array(whole, dtype=np.float32)
    pixels /= 255
    if has_alpha:
        alpha = pixels[:, :, 3:]
        pixels = pixels[:, :, :3] * alpha + np.asarray(background, dtype=np.float32) * (1 - alpha)
    if size is not None and size != (pixels.shape[1], pixels.shape[0]):
        whole = Image.fromarray(np.rint(pixels * 255).astype(np.uint8))
        pixels = np.asarray(whole.resize(size, Image.Resampling.BICUBIC), dtype=np.float32) / 255
    return np.ascontiguousarray(pixels)


def load_mask(path: Path, size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """Loads the mask of a photo: True for pixels that are compared, in training and evaluation.

    These pixels are brighter than middle grey in the file.

    Args:
        path: The file, 8 bits per channel.
        size: Width and height to resize to (nearest pixel).

    Raises:
        DatasetError: If the file is missing or not such an image.
    """
    with _open(path) as image:
        if image.mode not in ("1", *_OPAQUE_MODES, *_ALPHA_MODES):
            raise DatasetError(f"{path}: masks in mode {image.mode} are not read; convert it to 8-bit grey")
        _check_pixels(path, image, _FREE_MASK_PIXELS)
        try:
            grey = np.asarray(image.convert("L").resize(size, Image.Resampling.NEAREST))
        except (OSError, SyntaxError, struct.error, *MALFORMED) as error:
            raise DatasetError(f"{path}: the mask is damaged: {error}") from error
    return grey > 127


def limited_size(width: int, height: int, max_width: int | None) -> tuple[int, int]:
    """Returns the size of an image that is scaled down to the width `max_width` if it is wider, as in HAC++."""
    if max_width is None or width <= max_width:
        return width, height
    # as in HAC++: another order of operations may give a result that differs by a pixel
    factor = width / max_width
    return max(1, int(width / factor)), max(1, int(height / factor))


def _check_pixels(path: Path, image: Image.Image, free: int) -> None:
    """Rejects an image with implausibly many pixels for its file size (decompression bomb).

    Args:
        path: The file, for the message.
        image: The image, not yet decompressed.
        free: Number of pixels that are always accepted.
    """
    size = path.stat().st_size
    if image.width * image.height > max(free, _PIXELS_PER_BYTE * size):
        raise DatasetError(f"{path}: {image.width} x {image.height} pixels are more than {size} bytes of file can hold")


def _open(path: Path) -> Image.Image:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `_check_pixels` limits the size before decoding
            return Image.open(path, formats=_FORMATS)
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: the image is missing") from error
    except Image.DecompressionBombError as error:
        most = 2 * (Image.MAX_IMAGE_PIXELS or 0)  # for smaller ones, Pillow only warns
        raise DatasetError(
            f"{path}: has more than {most:,} pixels, which is the limit: scale the photo down"
        ) from error
    except (OSError, SyntaxError, struct.error, *MALFORMED) as error:
        why = str(error).split(str(path))[0].rstrip(" '")
        raise DatasetError(format_error(path, "a readable image", why)) from error
