"""EXIF orientation: are the cameras of photos those of the stored or of the turned pixels?

Some programs that find poses turn photos as their EXIF orientation demands (COLMAP 3.8 to 3.11, RealityScan), others
read the pixels as they are stored (other releases of COLMAP, nerfstudio). Only the shape of the cameras shows which.
"""

from collections.abc import Sequence
from pathlib import Path

from splatwire.data.colmap import ColmapView
from splatwire.data.photos import is_turned, photo_size
from splatwire.data.transforms_json import TransformsView
from splatwire.errors import DatasetError

_MAX_ASPECT_ERROR_PX = 1.5


def shape_fits(photo: tuple[int, int], camera: tuple[int, int]) -> bool:
    """Returns True if a photo of one size can be one of a camera of another, reduced."""
    return abs(photo[1] - camera[1] * photo[0] / camera[0]) <= _MAX_ASPECT_ERROR_PX


def views_are_upright(views: Sequence[ColmapView | TransformsView], image_paths: Sequence[Path]) -> bool:
    """Returns True if cameras are those of photos after the turn that their EXIF orientation demands.

    Photos whose shape decides speak for the others, too.

    Args:
        views: The cameras.
        image_paths: Their photos.

    Raises:
        DatasetError: If photos are turned by EXIF and no shape decides, or shapes contradict each other.
    """
    turned = [(view, file) for view, file in zip(views, image_paths, strict=True) if is_turned(file)]
    if not turned:
        return False
    votes = set()
    for view, file in turned:
        sizes = photo_size(file), photo_size(file, upright=True)
        camera = (view.width, view.height)
        stored, upright = (shape_fits(size, camera) for size in sizes)
        if not (stored or upright):
            return False  # photos and cameras do not fit at all, which is reported with their sizes
        if stored and upright:  # nearly square
            stored, upright = (size == camera for size in sizes)
        if stored != upright and (isinstance(view, ColmapView) or view.size_is_known):
            votes.add(upright)
    if len(votes) == 1:
        return votes.pop()
    raise DatasetError(
        f"{turned[0][1]}: its EXIF orientation turns the photo, and its shape does not show if the poses are those of "
        "the turned one. If they are, turn the pixels (`mogrify -auto-orient`), else remove the tag "
        "(`exiftool -Orientation=`)"
    )
