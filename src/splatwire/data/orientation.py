"""Detects if cameras describe the stored pixels of photos, or the photos after their EXIF rotation.

Programs that estimate camera poses differ in this. The aspect ratio of the cameras shows which case applies.
"""

from collections.abc import Sequence
from pathlib import Path

from splatwire.data.colmap import ColmapView
from splatwire.data.photos import has_exif_rotation, photo_size
from splatwire.data.transforms_json import PosedPhoto
from splatwire.errors import DatasetError

# COLMAP 3.8 to 3.11 and RealityScan apply the EXIF orientation; other releases of COLMAP and nerfstudio use the stored
# pixels.
_MAX_ASPECT_ERROR_PX = 1.5


def shape_fits(photo: tuple[int, int], camera: tuple[int, int]) -> bool:
    """True if a photo and a camera have the same aspect ratio."""
    return abs(photo[1] - camera[1] * photo[0] / camera[0]) <= _MAX_ASPECT_ERROR_PX


def needs_exif_rotation(views: Sequence[ColmapView | PosedPhoto], image_paths: Sequence[Path]) -> bool:
    """Decides if the cameras of a dataset describe the photos after their EXIF rotation, or the pixels as stored.

    Args:
        views: The cameras.
        image_paths: Photo of each view.

    Returns:
        True if the cameras describe rotated photos, so that readers must apply the EXIF rotation. False if the cameras
        describe the stored pixels.

    Raises:
        DatasetError: If photos have an EXIF rotation, and their aspect ratios do not show which case applies. Either
            the photos fit both cases, or some photos fit one case and other photos the other case.
    """
    rotated = [(view, file) for view, file in zip(views, image_paths, strict=True) if has_exif_rotation(file)]
    if not rotated:
        return False
    votes = set()
    for view, file in rotated:
        sizes = photo_size(file), photo_size(file, apply_exif=True)
        camera = (view.width, view.height)
        fits_stored, fits_rotated = (shape_fits(size, camera) for size in sizes)
        if not (fits_stored or fits_rotated):
            return False  # sizes do not match at all; reported elsewhere
        if fits_stored and fits_rotated:  # nearly square
            fits_stored, fits_rotated = (size == camera for size in sizes)
        if fits_stored != fits_rotated and (isinstance(view, ColmapView) or view.size_is_known):
            votes.add(fits_rotated)
    if len(votes) == 1:
        return votes.pop()
    raise DatasetError(
        f"{rotated[0][1]}: its EXIF orientation turns the photo, and its shape does not show if the poses are those of "
        "the turned one. If they are, turn the pixels (`mogrify -auto-orient`), else remove the tag "
        "(`exiftool -Orientation=`)"
    )
