"""The views of an evaluation: cameras, and the pictures that others are compared with."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.metrics import black_outside, psnr, ssim
from splatwire.model.appearance import Scene
from splatwire.ops.arrays import to_numpy
from splatwire.render import iterate_views
from splatwire.scene import Cameras
from splatwire.scene.background import Background


@dataclass(frozen=True, eq=False)
class ReferenceViews:
    """Cameras with one reference picture each; pictures are loaded when they are asked for.

    Attributes:
        cameras: The cameras.
        load: Gives the reference picture of a view, RGB in [0, 1].
        source: What the references are, for the report, such as `photos`.
        background: RGB behind everything in renders; None for that of each scene.
        load_mask: Gives the mask of a view, True where its picture counts, None where all of it does; None if no view
            has a mask.
    """

    cameras: Cameras
    load: Callable[[int], Any]
    source: str
    background: Background | None = None
    load_mask: Callable[[int], Any] | None = None

    def reference(self, view: int) -> Float[np.ndarray, "H W 3"]:
        """Returns the reference picture of a view, black outside its mask.

        Raises:
            InvalidValueError: If it is not of the cameras' size.
        """
        image = to_numpy(self.load(view))
        if tuple(image.shape) != (self.cameras.height, self.cameras.width, 3):
            size = f"{self.cameras.width} x {self.cameras.height}"
            raise InvalidValueError(f"reference of view {self.cameras.names[view]} is {tuple(image.shape)}, not {size}")
        mask = self.mask(view)
        return image if mask is None else black_outside(image[None], mask[None])[0]

    @property
    def masked(self) -> bool:
        """Whether any view may have a mask."""
        return self.load_mask is not None

    def mask(self, view: int) -> Bool[np.ndarray, "H W"] | None:
        """Returns where the picture of a view counts; None where all of it does."""
        mask = None if self.load_mask is None else self.load_mask(view)
        return None if mask is None else to_numpy(mask)

    def compared(self, view: int, image: Float[np.ndarray, "H W 3"]) -> "Compared":
        """Puts a picture of a view beside its reference, both black where nothing counts."""
        reference, mask = self.reference(view)[None], self.mask(view)
        if mask is None:
            return Compared(image[None], reference, None)
        return Compared(black_outside(image[None], mask[None]), reference, mask[None])


@dataclass(frozen=True, eq=False)
class Compared:
    """A picture and its reference, one view of each, black outside its mask.

    Attributes:
        image: RGB in [0, 1].
        reference: RGB in [0, 1].
        mask: True where pixels count; None where all do.
    """

    image: Float[np.ndarray, "1 H W 3"]
    reference: Float[np.ndarray, "1 H W 3"]
    mask: Bool[np.ndarray, "1 H W"] | None

    def psnr(self) -> float:
        """Decibels of what counts."""
        return float(psnr(self.image, self.reference, self.mask)[0])

    def ssim(self) -> float:
        """Mean structural similarity of what counts."""
        return float(ssim(self.image, self.reference, self.mask)[0])


def spread(num_views: int, count: int | None) -> list[int]:
    """Indices of at most `count` views, spread evenly from the first to the last of `num_views`; all for None."""
    if count is None or count >= num_views:
        return list(range(num_views))
    return [(num_views - 1) * i // max(count - 1, 1) for i in range(count)]


def photo_views(dataset: Dataset) -> ReferenceViews:
    """Compares with the photos of a dataset, inside their masks."""
    masked = any(dataset.mask_paths)
    mask = dataset.mask if masked else None
    return ReferenceViews(dataset.cameras, dataset.image, photo_source(masked=masked), dataset.background, mask)


def photo_source(*, masked: bool) -> str:
    """What references are that are photos, for reports."""
    return "photos inside their masks" if masked else "photos"


def views_of(
    scene: Scene,
    cameras: Cameras,
    renderer: str,
    background: Background | None = None,
) -> Iterable[Float[np.ndarray, "H W 3"]]:
    """Draws view after view; in front of the scene's own background where none is given."""
    behind = None if background is None else np.array(background)
    return iterate_views(scene, cameras, renderer=renderer, background=behind)
