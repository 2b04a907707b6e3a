"""Camera views in which a calibration measures picture quality, and the reference pictures of these views."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image

from splatwire.anchors.appearance import origin_of
from splatwire.arguments import CheckedFields, checked
from splatwire.data import Dataset
from splatwire.errors import whole_number
from splatwire.metrics import psnr
from splatwire.ops.arrays import to_numpy
from splatwire.render import iterate_views
from splatwire.types import Cameras
from splatwire.types.background import Background
from splatwire.types.origin import Origin
from splatwire.types.scene import Scene

AnyScene = TypeVar("AnyScene", bound=Scene)
Progress = Callable[[str, float], None]
"""Called with the name of the current task and its completed share, 0 to 1."""
MAX_VIEWS = 1_000_000
_MAX_DECIBELS = 100.0
"""Upper limit of a picture's PSNR in decibels; the PSNR of an exact picture is infinite and would spoil a mean."""


@dataclass(frozen=True, eq=False)
class CalibrationViews(CheckedFields):
    """Camera views in which a calibration compares pictures with photos or with pictures of the complete scene.

    Attributes:
        cameras: The cameras, usually those of the training views.
        photo: Function that returns the photo of a view, by its index; None to compare with pictures of the complete
            scene.
        background: RGB of the background; None for the background with which the scene was trained.
        mask: Function that returns the mask of a view by its index, True for pixels that are compared; None to compare
            all pixels.
    """

    cameras: Cameras
    photo: Callable[[int], Any] | None = None
    background: Background | None = None
    mask: Callable[[int], Any] | None = None

    @staticmethod
    def of_photos(photos: Dataset) -> "CalibrationViews":
        """Returns the views of a dataset, with the photos, masks and background of the dataset."""
        mask = photos.mask if photos.mask_paths else None
        return CalibrationViews(photos.cameras, photos.image, photos.background, mask)

    def reduced(self, count: int, width: int) -> "CalibrationViews":
        """Returns at most `count` of the views, evenly spaced, scaled to a width of at most `width` pixels."""
        chosen = spread_evenly(self.cameras.num_views, count)
        cameras = self.cameras.select(chosen)
        cameras = cameras.scaled(min(1.0, width / cameras.width))
        photo, mask = self.photo, self.mask
        if photo is None:
            return replace(self, cameras=cameras)
        size = (cameras.height, cameras.width)
        return CalibrationViews(
            cameras,
            lambda view: _resized(to_numpy(photo(chosen[view])), size),
            self.background,
            None if mask is None else lambda view: _resized_mask(_array(mask(chosen[view])), size),
        )

    def relative_to(self, origin: Origin) -> "CalibrationViews":
        """Returns the views with cameras relative to a different origin."""
        return replace(self, cameras=self.cameras.relative_to(origin))

    def with_background_of_views(self, scene: AnyScene) -> AnyScene:
        """Returns a scene with the background colour of these views, or the unchanged scene if the views have none."""
        return scene if self.background is None else replace(scene, background=self.background)


@dataclass(frozen=True, eq=False)
class References:
    """Reference pictures with which rendered views are compared.

    Attributes:
        cameras: The cameras of the views, relative to the origin of the scene.
        images: Reference picture of each view, (H, W, 3).
        masks: Mask of each view, True for pixels that are compared, (H, W); None if all pixels are compared.
    """

    cameras: Cameras
    images: list[np.ndarray]
    masks: list[np.ndarray | None]

    @staticmethod
    def of(scene: Scene, views: CalibrationViews) -> "References":
        """Returns the reference pictures of views: photos or, if the views have none, pictures of the scene."""
        views = views.relative_to(origin_of(scene))
        photo, mask, numbers = views.photo, views.mask, range(views.cameras.num_views)
        images = (
            list(iterate_views(scene, views.cameras)) if photo is None else [to_numpy(photo(view)) for view in numbers]
        )
        return References(views.cameras, images, [None if mask is None else _array(mask(view)) for view in numbers])

    def psnr(self, view: int, picture: Float[Any, "H W 3"]) -> float:
        """Returns the PSNR of a rendered view against the reference, decibels."""
        # At most 100.
        mask = self.masks[view]
        decibels = psnr(picture[None], self.images[view][None], None if mask is None else mask[None])
        return min(float(decibels[0]), _MAX_DECIBELS)


@checked
def spread_evenly(total: int, count: int) -> list[int]:
    """Returns at most `count` evenly spaced indices from 0 to `total - 1`, including the first and the last.

    Raises:
        InvalidValueError: If a number is negative.
    """
    whole_number(total, "total", 0, MAX_VIEWS)
    whole_number(count, "count")
    return np.unique(np.linspace(0, total - 1, min(count, total)).round().astype(int)).tolist()


def _array(mask: Any) -> np.ndarray | None:
    return None if mask is None else to_numpy(mask)


def _resized(image: Float[np.ndarray, "H W C"], size: tuple[int, int]) -> Float[np.ndarray, "H2 W2 C"]:
    if tuple(image.shape[:2]) == size:
        return image
    height, width = size
    planes = [Image.fromarray(np.ascontiguousarray(plane)) for plane in np.moveaxis(image, 2, 0)]
    return np.stack([np.asarray(plane.resize((width, height), Image.Resampling.BILINEAR)) for plane in planes], axis=2)


def _resized_mask(mask: Bool[np.ndarray, "H W"] | None, size: tuple[int, int]) -> Bool[np.ndarray, "H2 W2"] | None:
    """Resizes the mask of a photo to the size of the resized photo; returns None without a mask.

    Args:
        mask: Mask of the pixels of the photo that are compared, or None.
        size: Size of the resized photo in pixels.
    """
    # A resized pixel is True if all contributing original pixels are True.
    if mask is None:
        return None
    return _resized((~mask)[..., None].astype(np.float32), size)[..., 0] == 0
