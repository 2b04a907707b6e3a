"""Where a calibration looks from, and what should be seen there."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image

from splatwire.data import Dataset
from splatwire.metrics import psnr
from splatwire.model.appearance import Scene
from splatwire.ops.arrays import to_numpy
from splatwire.render import iterate_views
from splatwire.scene import Cameras
from splatwire.scene.background import Background

AnyScene = TypeVar("AnyScene", bound=Scene)
Progress = Callable[[str, float], None]
"""Called with what is being done and the share of it that is done, 0 to 1."""
_MOST_DECIBELS = 100.0
"""What a picture that equals its reference counts as in a mean."""


@dataclass(frozen=True, eq=False)
class CalibrationViews:
    """Where the scene is looked at from.

    Attributes:
        cameras: The cameras, training views as a rule.
        photo: Gives the photo of a view; None where there are none: then the complete scene is the reference.
        background: RGB behind everything; None for what the scene was trained in front of.
        mask: Gives the mask of a view's photo, True where it counts, None where all of it does; None if there are none.
    """

    cameras: Cameras
    photo: Callable[[int], Any] | None = None
    background: Background | None = None
    mask: Callable[[int], Any] | None = None

    @staticmethod
    def of_photos(photos: Dataset) -> "CalibrationViews":
        """The views of photos, with their masks and the background that they were composed on."""
        mask = photos.mask if photos.mask_paths else None
        return CalibrationViews(photos.cameras, photos.image, photos.background, mask)

    def reduced(self, count: int, width: int) -> "CalibrationViews":
        """At most `count` views, spread evenly, at most `width` pixels wide."""
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

    def in_front(self, scene: AnyScene) -> AnyScene:
        """The scene in front of the background of these views."""
        return scene if self.background is None else replace(scene, background=self.background)


@dataclass(frozen=True, eq=False)
class References:
    """What views should show.

    Attributes:
        cameras: The cameras.
        images: A picture of each view, (H, W, 3).
        masks: True where it counts, (H, W); None of a view all of which does.
    """

    cameras: Cameras
    images: list[np.ndarray]
    masks: list[np.ndarray | None]

    @staticmethod
    def of(scene: Scene, views: CalibrationViews) -> "References":
        """Photos where there are some, the complete scene's pictures elsewhere."""
        photo, mask, numbers = views.photo, views.mask, range(views.cameras.num_views)
        images = (
            list(iterate_views(scene, views.cameras)) if photo is None else [to_numpy(photo(view)) for view in numbers]
        )
        return References(views.cameras, images, [None if mask is None else _array(mask(view)) for view in numbers])

    def psnr(self, view: int, picture: Float[Any, "H W 3"]) -> float:
        """Decibels of a picture of a view, at most 100."""
        mask = self.masks[view]
        decibels = psnr(picture[None], self.images[view][None], None if mask is None else mask[None])
        return min(float(decibels[0]), _MOST_DECIBELS)


def spread_evenly(total: int, count: int) -> list[int]:
    """At most `count` of the numbers below `total`, the first and the last among them."""
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
    """Where the resized photo is made of pixels that count and of no others."""
    if mask is None:
        return None
    return _resized((~mask)[..., None].astype(np.float32), size)[..., 0] == 0
