"""Camera paths: interpolation between cameras."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.errors import InvalidValueError
from splatwire.types import Cameras

PICTURES_A_SECOND = 4


@dataclass(frozen=True, eq=False)
class Walk:
    """A camera path through a scene.

    Attributes:
        cameras: Key cameras; positions are interpolated linearly, rotations along the shortest arc.
        seconds: Time from the first camera to the last, seconds. The time between consecutive cameras is always the
            same.

    Raises:
        InvalidValueError: If the duration is not positive, or more than an hour.
    """

    cameras: Cameras
    seconds: float

    def __post_init__(self) -> None:
        if not 0 < self.seconds <= 3600:
            raise InvalidValueError(f"a path takes more than 0 and at most 3600 seconds, not {self.seconds:g}")

    def at(self, seconds: float) -> Cameras:
        """Returns the camera of a camera path at a given time."""
        # Times outside the path are clamped.
        cameras, last = self.cameras, self.cameras.num_views - 1
        position = min(max(seconds / self.seconds, 0.0), 1.0) * last
        before = min(int(position), max(last - 1, 0))
        if not last:
            return cameras
        share, pair = position - before, cameras.viewmats[before : before + 2].astype(np.float64)
        turn = Slerp([0, 1], Rotation.from_matrix(pair[:, :3, :3]))(share).as_matrix()
        eyes = [-pose[:3, :3].T @ pose[:3, 3] for pose in pair]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, -turn @ ((1 - share) * eyes[0] + share * eyes[1])
        near = cameras.select([before + round(share)])
        return replace(near, viewmats=pose[None].astype(np.float32))

    def viewpoint(self, seconds: float) -> Viewpoint:
        """Returns the viewpoint of the camera at a time."""
        return viewpoint_of(self.at(seconds))

    @property
    def times(self) -> list[float]:
        """Evenly spaced times along the path at which images are compared, seconds."""
        count = math.floor(self.seconds * PICTURES_A_SECOND + 1e-9)
        return [number / PICTURES_A_SECOND for number in range(count + 1)]


def viewpoint_of(camera: Cameras) -> Viewpoint:
    """Returns the viewpoint of a camera.

    Args:
        camera: The camera; if there are several views, the first one is used.
    """
    viewmat, focal = camera.viewmats[0].astype(np.float64), float(camera.Ks[0, 0, 0])
    return Viewpoint(viewmat, focal, camera.width, camera.height, camera.origin)
