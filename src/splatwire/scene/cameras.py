"""Pinhole cameras: OpenCV world-to-camera matrices and intrinsics in pixels."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.scene.origin import NO_ORIGIN, Origin
from splatwire.scene.shapes import check_arrays

MAX_PIXELS = 1 << 27
"""More than any camera has (134 million); as float32 a picture of them takes 1.6 GB."""


def check_size(width: int, height: int) -> None:
    """Checks that pictures of a size can be held.

    Raises:
        InvalidValueError: If there is no pixel, or there are more than `MAX_PIXELS`.
    """
    if width < 1 or height < 1:
        raise InvalidValueError(f"pictures of {width} x {height} pixels have no pixels")
    if width * height > MAX_PIXELS:
        raise InvalidValueError(
            f"pictures of {str(width)[:20]} x {str(height)[:20]} pixels are over the limit of {MAX_PIXELS:,} pixels"
        )


@dataclass(frozen=True, eq=False)
class Cameras:
    """C pinhole cameras of one image size.

    Matrices are numpy arrays of float32; training makes the same of torch tensors on its device.

    Attributes:
        viewmats: World-to-camera matrices, OpenCV axes (x right, y down, z forward).
        Ks: Intrinsics in pixels; the centre of the top-left pixel is (0.5, 0.5).
        width: Image width in pixels.
        height: Image height in pixels.
        names: One name per view, without a file suffix.
        origin: World coordinates that the matrices are relative to.
    """

    viewmats: Float[Any, "C 4 4"]
    Ks: Float[Any, "C 3 3"]
    width: int
    height: int
    names: tuple[str, ...]
    origin: Origin = NO_ORIGIN

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_arrays(self, {"viewmats": ("C", 4, 4), "Ks": ("C", 3, 3)})
        if len(self.names) != self.viewmats.shape[0]:
            raise InvalidValueError(f"{len(self.names)} names for {self.viewmats.shape[0]} cameras")
        check_size(self.width, self.height)

    @property
    def num_views(self) -> int:
        """Number of cameras, C."""
        return len(self.names)

    @property
    def centers(self) -> Float[Any, "C 3"]:
        """Camera centres in world coordinates, relative to `origin`."""
        rotation, translation = self.viewmats[:, :3, :3], self.viewmats[:, :3, 3]
        return -(rotation * translation[:, :, None]).sum(1)

    def relative_to(self, origin: Origin) -> "Cameras":
        """Returns the same cameras with matrices that are relative to another origin."""
        if origin == self.origin:
            return self
        viewmats = to_numpy(self.viewmats)
        poses = viewmats.astype(np.float64)
        poses[:, :3, 3] += poses[:, :3, :3] @ (np.array(origin) - np.array(self.origin))
        return replace(self, viewmats=poses.astype(viewmats.dtype), origin=origin)

    def select(self, views: list[int]) -> "Cameras":
        """Returns the cameras at the given indices, in that order."""
        names = tuple(self.names[v] for v in views)
        return replace(self, viewmats=self.viewmats[views], Ks=self.Ks[views], names=names)

    def scaled(self, factor: float) -> "Cameras":
        """Returns cameras of images `factor` times as wide and high (both sides rounded to whole pixels)."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        Ks = to_numpy(self.Ks)
        scale = np.array([[width / self.width], [height / self.height], [1.0]], Ks.dtype)
        return replace(self, Ks=Ks * scale, width=width, height=height)
