"""The views of an evaluation: cameras, and the pictures that others are compared with."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.data import Dataset
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene
from splatwire.render import iterate_views
from splatwire.scene import Cameras
from splatwire.scene.background import Background
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class ReferenceViews:
    """Cameras with one reference picture each; pictures are loaded when they are asked for.

    Attributes:
        cameras: The cameras.
        load: Gives the reference picture of a view, RGB in [0, 1].
        source: What the references are, for the report: `photos` or `renders of the lossless scene`.
        background: RGB behind everything in renders; None for that of each scene.
    """

    cameras: Cameras
    load: Callable[[int], Tensor]
    source: str
    background: Background | None = None

    def reference(self, view: int) -> Float[Tensor, "H W 3"]:
        """Returns the reference picture of a view.

        Raises:
            InvalidValueError: If it is not of the cameras' size.
        """
        image = self.load(view)
        if tuple(image.shape) != (self.cameras.height, self.cameras.width, 3):
            size = f"{self.cameras.width} x {self.cameras.height}"
            raise InvalidValueError(f"reference of view {self.cameras.names[view]} is {tuple(image.shape)}, not {size}")
        return image

    def every(self, count: int | None) -> "ReferenceViews":
        """Returns at most `count` views, spread evenly; all for None."""
        chosen = spread(self.cameras.num_views, count)
        if len(chosen) == self.cameras.num_views:
            return self
        return replace(self, cameras=self.cameras.select(chosen), load=lambda view: self.load(chosen[view]))


def spread(num_views: int, count: int | None) -> list[int]:
    """Indices of at most `count` views, spread evenly from the first to the last of `num_views`; all for None."""
    if count is None or count >= num_views:
        return list(range(num_views))
    return [(num_views - 1) * i // max(count - 1, 1) for i in range(count)]


def photo_views(dataset: Dataset) -> ReferenceViews:
    """Compares with the photos of a dataset."""
    source = "photos, whole in spite of their masks" if dataset.mask_paths else "photos"
    return ReferenceViews(dataset.cameras, dataset.image, source, dataset.background)


def rendered_views(
    scene: AnchorScene | Splats,
    cameras: Cameras,
    folder: Path,
    *,
    renderer: str = "cpu",
    background: Background | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReferenceViews:
    """Compares with a scene's own renders, which are drawn now and kept in a file (memory stays bounded).

    Args:
        scene: The scene without losses, or explicit Gaussians.
        cameras: The cameras.
        folder: Where the file may lie; it must outlive the views.
        renderer: Name of the renderer.
        background: RGB behind everything; None for that of each scene.
        progress: Called with the share of views drawn.
    """
    shape = (cameras.num_views, cameras.height, cameras.width, 3)
    pictures = np.lib.format.open_memmap(folder / "references.npy", mode="w+", dtype=np.float32, shape=shape)
    for view, image in enumerate(views_of(scene, cameras, renderer, background)):
        pictures[view] = image.numpy()
        if progress:
            progress((view + 1) / cameras.num_views)
    source = "renders of explicit Gaussians" if isinstance(scene, Splats) else "renders of the lossless scene"
    return ReferenceViews(cameras, lambda view: torch.from_numpy(pictures[view].copy()), source, background)


def views_of(
    scene: AnchorScene | Splats,
    cameras: Cameras,
    renderer: str,
    background: Background | None = None,
) -> Iterable[Float[Tensor, "H W 3"]]:
    """Draws view after view, on the CPU; in front of the scene's own background where none is given."""
    behind = None if background is None else torch.tensor(background)
    for image in iterate_views(scene, cameras, renderer=renderer, background=behind):
        yield image.cpu()
