"""Views for fine-tuning: cameras around a scene, and their pictures."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, UInt8

from splatwire.anchors.appearance import origin_of
from splatwire.arguments import checked
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.files.mmap_array import large_empty
from splatwire.render import iterate_views
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import HELD_OUT_VIEWS, surrounding_cameras
from splatwire.types import Cameras
from splatwire.types.origin import Origin
from splatwire.types.scene import Scene

VIEWS, SIZE = 240, 400
"""Number of generated views, and their width and height in pixels."""
_FRAMING_INTERVAL = 6
"""Of this number of generated views, one frames the scene as a page does; the others surround it at two distances."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """Cameras and reference pictures, with which renderings of a fine-tuned scene are compared.

    Attributes:
        cameras: The cameras.
        images: RGB of the reference pictures as bytes, 0 to 255.
        masks: True for pixels that are compared; None if all are compared.
    """

    cameras: Cameras
    images: UInt8[np.ndarray, "C H W 3"]
    masks: Bool[np.ndarray, "C H W"] | None = None

    def __post_init__(self) -> None:
        cameras = self.cameras
        if self.images.shape != (cameras.num_views, cameras.height, cameras.width, 3) or not cameras.num_views:
            raise InvalidValueError(
                f"{cameras.num_views} cameras of {cameras.width} x {cameras.height} pixels, but pictures of shape "
                f"{tuple(self.images.shape)}"
            )
        if self.masks is not None and self.masks.shape != self.images.shape[:3]:
            raise InvalidValueError(f"masks of shape {self.masks.shape} for pictures of shape {self.images.shape}")

    @staticmethod
    def of_photos(dataset: Dataset, origin: Origin, progress: Callable[[float], None] | None = None) -> "Pictures":
        """Reads the photos of a dataset and their masks.

        Args:
            dataset: The photos.
            origin: Origin of the scene in world coordinates. The cameras of the result are relative to this point.
            progress: Called with the finished share of the photos.

        Raises:
            DatasetError: If a photo or mask is missing or damaged.
        """
        cameras = dataset.cameras.relative_to(origin)
        shape = (cameras.num_views, cameras.height, cameras.width)
        images = large_empty((*shape, 3), np.uint8)
        masks = large_empty(shape, np.bool_) if any(dataset.mask_paths) else None
        for view in range(cameras.num_views):
            images[view] = np.rint(dataset.image(view) * 255)
            if masks is not None:
                mask = dataset.mask(view)
                masks[view] = True if mask is None else mask
            if progress:
                progress((view + 1) / cameras.num_views)
        return Pictures(cameras, images, masks)


def fitting_cameras(scene: Scene, num_views: int = VIEWS, size: int = SIZE) -> Cameras:
    """Places cameras for fine-tuning around a scene.

    A sixth of the cameras frame the scene. The others are at two distances from it.

    Args:
        scene: The scene.
        num_views: Number of cameras, at least 2.
        size: Width and height of the images, pixels.

    Raises:
        InvalidValueError: If the number of views, pixels or elements is too small.
    """
    # If the scene encloses the cameras, some of them look outwards. No camera equals one of
    # `splatwire.evaluation.views.held_out_cameras`.
    num_framing = max(num_views // _FRAMING_INTERVAL, 1)
    if HELD_OUT_VIEWS in (num_framing, num_views - num_framing):  # poses around a scene depend on their number
        num_framing += 1
    surrounding, framing = (
        surrounding_cameras(scene, num_views - num_framing, size),
        framing_cameras(scene, num_framing, size),
    )
    names = tuple(f"fit_{view:03d}" for view in range(num_views))
    return replace(
        surrounding,
        viewmats=np.concatenate([surrounding.viewmats, framing.viewmats]),
        Ks=np.concatenate([surrounding.Ks, framing.Ks]),
        names=names,
        origin=origin_of(scene),
    )


@checked
def own_pictures(scene: Scene, cameras: Cameras, progress: Callable[[float], None] | None = None) -> Pictures:
    """Renders a scene in the given views, as reference pictures for fine-tuning without photos.

    Args:
        scene: The complete scene.
        cameras: The cameras.
        progress: Called with the finished share of the views.
    """
    images = large_empty((cameras.num_views, cameras.height, cameras.width, 3), np.uint8)
    for view, image in enumerate(iterate_views(scene, cameras)):
        images[view] = np.rint(image * 255)
        if progress:
            progress((view + 1) / cameras.num_views)
    return Pictures(cameras.relative_to(origin_of(scene)), images)
