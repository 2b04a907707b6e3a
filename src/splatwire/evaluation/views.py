"""Reference views of an evaluation: cameras and reference images."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import CheckedFields, checked
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.metrics import black_outside
from splatwire.metrics.registry import measure_view
from splatwire.ops.arrays import to_numpy
from splatwire.render.closeups import closeup_cameras
from splatwire.render.importance import HELD_OUT_VIEWS, surrounding_cameras
from splatwire.types import Cameras
from splatwire.types.background import Background
from splatwire.types.scene import Scene

HELD_OUT_SIZE = 400
"""Width and height of the images of `held_out_cameras`, pixels."""


@dataclass(frozen=True, eq=False)
class ReferenceViews(CheckedFields):
    """Cameras with one reference image each; images are loaded on demand.

    Attributes:
        cameras: The cameras.
        load: Function that returns the reference image of a view, RGB in [0, 1].
        source: Kind of references for the report, such as `photos`.
        background: RGB of the background in renders; None for the background of each scene.
        load_mask: Function that returns the mask of evaluated pixels of a view; None if no view has a mask.
    """

    cameras: Cameras
    load: Callable[[int], Any]
    source: str
    background: Background | None = None
    load_mask: Callable[[int], Any] | None = None

    def reference(self, view: int) -> Float[np.ndarray, "H W 3"]:
        """Returns the reference image of a view, black outside its mask.

        Raises:
            InvalidValueError: If its size differs from the cameras' image size.
        """
        image = to_numpy(self.load(view))
        if tuple(image.shape) != (self.cameras.height, self.cameras.width, 3):
            size = f"{self.cameras.width} x {self.cameras.height}"
            raise InvalidValueError(f"reference of view {self.cameras.names[view]} is {tuple(image.shape)}, not {size}")
        mask = self.mask(view)
        return image if mask is None else black_outside(image[None], mask[None])[0]

    @property
    def has_masks(self) -> bool:
        """True if views can have masks of evaluated pixels."""
        return self.load_mask is not None

    def mask(self, view: int) -> Bool[np.ndarray, "H W"] | None:
        """Returns the mask of evaluated pixels of a view, or None if all pixels are evaluated."""
        mask = None if self.load_mask is None else self.load_mask(view)
        return None if mask is None else to_numpy(mask)

    def compared(self, view: int, image: Float[np.ndarray, "H W 3"]) -> "Compared":
        """Pairs a rendered image of a view with the reference image; both are black outside the view's mask."""
        reference, mask = self.reference(view)[None], self.mask(view)
        if mask is None:
            return Compared(image[None], reference, None)
        return Compared(black_outside(image[None], mask[None]), reference, mask[None])


@dataclass(frozen=True, eq=False)
class Compared:
    """An image and its reference for one view, both black outside the mask.

    Attributes:
        image: RGB in [0, 1].
        reference: RGB in [0, 1].
        mask: True for evaluated pixels; None for all pixels.
    """

    image: Float[np.ndarray, "1 H W 3"]
    reference: Float[np.ndarray, "1 H W 3"]
    mask: Bool[np.ndarray, "1 H W"] | None

    def measure(self, metric: str) -> float:
        """Computes the metric with the given name for the image and its reference, over the evaluated pixels."""
        return measure_view(metric, self.image, self.reference, self.mask)


def spread(num_views: int, count: int | None) -> list[int]:
    """Returns indices of at most `count` views, evenly spaced from first to last; all views if `count` is None."""
    if count is None or count >= num_views:
        return list(range(num_views))
    return [(num_views - 1) * i // max(count - 1, 1) for i in range(count)]


def held_out_cameras(scene: Scene) -> Cameras:
    """Places test cameras at near and far distances around a scene.

    Args:
        scene: The scene.

    Raises:
        InvalidValueError: If the scene has no elements.
    """
    # As test views, these cameras differ from those that encoders use to choose settings.
    return surrounding_cameras(scene, HELD_OUT_VIEWS, HELD_OUT_SIZE)


def held_out_closeups(scene: Scene) -> Cameras:
    """Places test cameras close to the surfaces of a scene.

    Args:
        scene: The scene.

    Raises:
        InvalidValueError: If the scene has no elements.
    """
    # No encoder uses these views.
    return closeup_cameras(scene, HELD_OUT_VIEWS, HELD_OUT_SIZE)


@checked
def photo_views(dataset: Dataset) -> ReferenceViews:
    """Returns the photos of a dataset as reference views, with their masks."""
    masked = any(dataset.mask_paths)
    mask = dataset.mask if masked else None
    return ReferenceViews(dataset.cameras, dataset.image, photo_source(masked=masked), dataset.background, mask)


def photo_source(*, masked: bool) -> str:
    """Returns the text with which reports describe reference images that are photos.

    Args:
        masked: True if only the pixels inside masks are evaluated; the text then mentions the masks.
    """
    return "photos inside their masks" if masked else "photos"
