"""Pinhole cameras: OpenCV world-to-camera matrices and intrinsics in pixels."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import check_fields, checked
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin
from splatwire.types.shapes import check_arrays, indices_of

MAX_PIXELS = 1 << 27
"""Maximum number of pixels of an image (134 million, more than any camera has); as float32 it takes 1.6 GB."""
NEAR_DEPTH = 0.2
"""Default near plane of cameras, world units: minimum depth of drawn centres (HAC++, decoding of a view)."""
MAX_SKEW = 1e-3
"""Maximum skew, pixels, and maximum deviation of the other constant entries of intrinsics."""
MAX_POSE_ERROR = 1e-2
"""Maximum deviation of R R^T from the identity, and of the last row of a pose matrix from 0, 0, 0, 1, in any entry."""


def check_size(width: int, height: int) -> None:
    """Checks that an image size is positive and within the memory limit.

    Raises:
        InvalidValueError: If a side is below 1, or there are more than `MAX_PIXELS` pixels.
    """
    if width < 1 or height < 1:
        raise InvalidValueError(f"pictures of {width} x {height} pixels have no pixels")
    if width * height > MAX_PIXELS:
        raise InvalidValueError(
            f"pictures of {str(width)[:20]} x {str(height)[:20]} pixels are over the limit of {MAX_PIXELS:,} pixels"
        )


def _are_poses(matrices: Float[np.ndarray, "C 4 4"]) -> Bool[np.ndarray, "C"]:
    """Returns a mask of the matrices that are rigid transforms, within `MAX_POSE_ERROR`."""
    poses = matrices.astype(np.float64)
    rotations, rows = poses[:, :3, :3], poses[:, 3]
    error = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0)
    last = np.abs(rows - np.array([0, 0, 0, 1])).max(axis=1, initial=0)
    return (np.maximum(error, last) <= MAX_POSE_ERROR) & (np.linalg.det(rotations) > 0)


@dataclass(frozen=True, eq=False)
class Cameras:
    """C pinhole cameras with the same image size.

    Matrices are float32 numpy arrays, or torch tensors in training.

    Attributes:
        viewmats: World-to-camera matrices, rotations and translations, OpenCV axes (x right, y down, z forward).
        Ks: Intrinsics in pixels, without skew; the centre of the top-left pixel is (0.5, 0.5).
        width: Image width in pixels.
        height: Image height in pixels.
        names: One name per view, without a file suffix.
        origin: World coordinates that the matrices are relative to.
        near_depth: Depth of the near plane, world units. A Gaussian is drawn only if its centre is beyond this depth.
            For views placed around a small scene, the near plane is nearer than `NEAR_DEPTH`.
    """

    viewmats: Float[Any, "C 4 4"]
    Ks: Float[Any, "C 3 3"]
    width: int
    height: int
    names: tuple[str, ...]
    origin: Origin = NO_ORIGIN
    near_depth: float = NEAR_DEPTH

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_arrays(self, {"viewmats": ("C", 4, 4), "Ks": ("C", 3, 3)})
        for side in ("width", "height"):
            object.__setattr__(self, side, whole_number(getattr(self, side), f"Cameras.{side}", 1))
        check_fields(self)
        if len(self.names) != self.viewmats.shape[0]:
            raise InvalidValueError(f"{len(self.names)} names for {self.viewmats.shape[0]} cameras")
        check_size(self.width, self.height)
        if not 0 < self.near_depth < np.inf:
            raise InvalidValueError(f"Cameras.near_depth must be above 0 and finite, not {self.near_depth:g}")
        for name in ("viewmats", "Ks"):
            matrices = getattr(self, name)
            if isinstance(matrices, np.ndarray) and not np.isfinite(matrices).all():
                view = int(np.flatnonzero(~np.isfinite(matrices).all(axis=(1, 2)))[0])
                raise InvalidValueError(f"Cameras.{name}: matrix {view} has a value that is not finite")
        if isinstance(self.viewmats, np.ndarray) and (off := ~_are_poses(self.viewmats)).any():
            view = int(np.flatnonzero(off)[0])
            raise InvalidValueError(
                f"Cameras.viewmats: matrix {view} is not [R t; 0 0 0 1] with a rotation R: is it transposed "
                "(`world_view_transform` of 3DGS is), scaled or mirrored?"
            )
        if isinstance(self.Ks, np.ndarray):
            fixed = self.Ks[:, [0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
            if (off := np.abs(fixed - np.array([0, 0, 0, 0, 1])).max(axis=1, initial=0) > MAX_SKEW).any():
                view = int(np.flatnonzero(off)[0])
                raise InvalidValueError(f"Cameras.Ks: matrix {view} is not [fx 0 cx; 0 fy cy; 0 0 1], in pixels")

    def __len__(self) -> int:
        """Number of cameras, C."""
        return len(self.names)

    def __getitem__(self, views: int | slice) -> "Cameras":
        """Returns the camera at an index, or the cameras of a slice, as `Cameras`.

        Raises:
            IndexError: If there is no such camera.
            InvalidValueError: If `views` is neither a whole number nor a slice.
        """
        if isinstance(views, slice):
            return self.select(list(range(len(self)))[views])
        view = whole_number(views, "the index of a camera", -len(self))
        if view >= len(self):
            raise IndexError(f"there is no camera {shown(view)}: there are {len(self)}, counted from 0")
        return self.select([view])

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
        """Returns the cameras with pose matrices relative to a different origin.

        Raises:
            InvalidValueError: If the origin is not three finite numbers.
        """
        origin = check_origin(origin)
        if origin == self.origin:
            return self
        viewmats = to_numpy(self.viewmats)
        poses = viewmats.astype(np.float64)
        poses[:, :3, 3] += poses[:, :3, :3] @ (np.array(origin) - np.array(self.origin))
        return replace(self, viewmats=poses.astype(viewmats.dtype), origin=origin)

    def select(self, views: Any) -> "Cameras":
        """Returns the cameras at the given indices (integers, a mask or a slice), in that order.

        Raises:
            InvalidValueError: If an index is out of range, or a mask has another length.
        """
        chosen = indices_of(views, self.num_views)
        names = tuple(self.names[view] for view in chosen)
        return replace(self, viewmats=self.viewmats[chosen], Ks=self.Ks[chosen], names=names)

    @checked
    def scaled(self, factor: float) -> "Cameras":
        """Returns the cameras for images `factor` times as wide and high; both sides are rounded to whole pixels.

        Raises:
            InvalidValueError: If the factor is not a finite number above 0, or the images exceed `MAX_PIXELS`.
        """
        if not 0 < factor < np.inf:
            raise InvalidValueError(f"factor: expected a finite number above 0, not {shown(factor)}")
        if self.width * factor * self.height * factor > 2 * MAX_PIXELS:  # also keeps the sides printable
            raise InvalidValueError(f"factor: {shown(factor)} exceeds the limit of {MAX_PIXELS:,} pixels")
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        Ks = to_numpy(self.Ks)
        scale = np.array([[width / self.width], [height / self.height], [1.0]], Ks.dtype)
        return replace(self, Ks=Ks * scale, width=width, height=height)
