"""Where a viewer looks from, how large its pictures are, and the colours of damage."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.render.importance import surrounding_cameras
from splatwire.scene import Anchors, Cameras


@dataclass(frozen=True)
class Look:
    """A point of view, in the words of a browser's orbit control.

    Attributes:
        position: Of the camera.
        wxyz: Its orientation, camera to world, OpenCV axes.
        fov: Vertical field of view, radians.
        aspect: Width over height.
    """

    position: tuple[float, float, float]
    wxyz: tuple[float, float, float, float]
    fov: float
    aspect: float

    def cameras(self, height: int) -> Cameras:
        """One pinhole camera of pictures that many pixels high."""
        width = max(1, round(height * self.aspect))
        rotation = _matrix(self.wxyz)
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ torch.tensor(self.position, dtype=torch.float64)
        focal = height / 2 / math.tan(self.fov / 2)
        intrinsics = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
        return Cameras(pose[None].float(), intrinsics, width, height, ("view",))


def _matrix(wxyz: tuple[float, float, float, float]) -> Float[Tensor, "3 3"]:
    w, x, y, z = (torch.tensor(wxyz, dtype=torch.float64) / math.hypot(*wxyz)).tolist()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64)


@dataclass(frozen=True)
class FirstLook:
    """Where an orbit control starts.

    Attributes:
        position: Of the camera.
        look_at: What it turns around.
        up: Which way is up.
        fov: Vertical field of view, radians.
    """

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]
    up: tuple[float, float, float]
    fov: float


def first_look(anchors: Anchors, cameras: Cameras | None) -> FirstLook:
    """Chooses where to begin.

    Args:
        anchors: The scene; their median is what the view turns around.
        cameras: Cameras that saw the scene: the first of them is taken, and up is what they agree on. None looks at
            the scene from the outside, with the world's -y axis up, as photo datasets mostly have it.
    """
    seen = surrounding_cameras(anchors, num_views=8) if cameras is None else cameras
    view = seen.num_views // 2 if cameras is None else 0
    middle = anchors.positions.double().median(dim=0).values
    pose = seen.viewmats.double()
    center = seen.centers[view].double()
    forward = pose[view, 2, :3]
    distance = max(float((middle - center) @ forward), 0.1 * float((middle - center).norm()), 1e-3)
    up = -pose[:, 1, :3].mean(dim=0) if cameras is not None else torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    if float(up.norm()) < 1e-6:
        up = -pose[view, 1, :3]
    fov = 2 * math.atan(seen.height / 2 / float(seen.Ks[view, 1, 1]))
    return FirstLook(_triple(center), _triple(center + distance * forward), _triple(up / up.norm()), fov)


def _triple(vector: Tensor) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


@dataclass(frozen=True)
class Pace:
    """How high pictures may be while the view moves, so that each takes about the same time on any machine.

    Attributes:
        target_s: Time a moving picture may take, seconds.
        low: Least height, pixels.
        high: Largest height.
        height: The next picture's.
    """

    target_s: float = 0.1
    low: int = 96
    high: int = 540
    height: int = 180

    def after(self, height: int, seconds: float) -> "Pace":
        """The pace after a picture of some height took so long; part of the cost does not shrink with the picture."""
        factor = min(max(self.target_s / max(seconds, 1e-6), 0.5), 1.5) ** 0.5
        wanted = round(height * factor / 4) * 4
        return Pace(self.target_s, self.low, self.high, min(max(wanted, self.low), self.high))


def heat(values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape 3"]:
    """Colours of damage from dark (0) over red to bright yellow (1): matplotlib's `inferno`."""
    import matplotlib

    table = torch.from_numpy(matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3].astype(np.float32))
    return table[(values.clamp(0, 1) * 255).round().long()]
