"""Where a calibration looks from, and what should be seen there."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.data import Dataset
from splatwire.metrics import psnr
from splatwire.model.appearance import Scene
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
    photo: Callable[[int], Tensor] | None = None
    background: Background | None = None
    mask: Callable[[int], Tensor | None] | None = None

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
            lambda view: _resized(photo(chosen[view]), size),
            self.background,
            None if mask is None else lambda view: _resized_mask(mask(chosen[view]), size),
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
    images: list[Tensor]
    masks: list[Tensor | None]

    @staticmethod
    def of(scene: Scene, views: CalibrationViews) -> "References":
        """Photos where there are some, the complete scene's pictures elsewhere."""
        photo, mask, numbers = views.photo, views.mask, range(views.cameras.num_views)
        images = list(iterate_views(scene, views.cameras)) if photo is None else [photo(view) for view in numbers]
        return References(views.cameras, images, [None if mask is None else mask(view) for view in numbers])

    def psnr(self, view: int, picture: Float[Tensor, "H W 3"]) -> float:
        """Decibels of a picture of a view, at most 100."""
        mask = self.masks[view]
        decibels = psnr(picture[None], self.images[view][None], None if mask is None else mask[None])
        return min(float(decibels[0]), _MOST_DECIBELS)


def spread_evenly(total: int, count: int) -> list[int]:
    """At most `count` of the numbers below `total`, the first and the last among them."""
    return np.unique(np.linspace(0, total - 1, min(count, total)).round().astype(int)).tolist()


def _resized(image: Float[Tensor, "H W 3"], size: tuple[int, int]) -> Float[Tensor, "H2 W2 3"]:
    if tuple(image.shape[:2]) == size:
        return image
    planes = image.permute(2, 0, 1)[None]
    return torch.nn.functional.interpolate(planes, size, mode="bilinear", antialias=True)[0].permute(1, 2, 0)


def _resized_mask(mask: Bool[Tensor, "H W"] | None, size: tuple[int, int]) -> Bool[Tensor, "H2 W2"] | None:
    """Where the resized photo is made of pixels that count and of no others."""
    if mask is None:
        return None
    return _resized((~mask)[..., None].expand(-1, -1, 3).float(), size)[..., 0] == 0
