"""Where a viewer looks from, how large its pictures are, and the colours of damage."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from splatwire.render.importance import cameras_around
from splatwire.scene import Cameras

Triple: TypeAlias = tuple[float, float, float]
NEAREST, FARTHEST = 0.35, 1.5
"""How near and far one may go: shares of the distance of the camera in about that direction, and of the largest one."""
ASIDE = math.radians(30)
"""How far from the direction of the closest camera one may look from."""
SPREAD = 0.9
"""Share of the anchors, along each axis, among which a view may turn."""


@dataclass(frozen=True)
class Look:
    """A point of view, in the words of a browser's orbit control.

    Attributes:
        position: Of the camera.
        wxyz: Its orientation, camera to world, OpenCV axes.
        fov: Vertical field of view, radians.
        aspect: Width over height.
    """

    position: Triple
    wxyz: tuple[float, float, float, float]
    fov: float
    aspect: float

    def cameras(self, height: int) -> Cameras:
        """One pinhole camera of pictures that many pixels high."""
        width = max(1, round(height * self.aspect))
        w, *xyz = self.wxyz
        rotation = torch.from_numpy(Rotation.from_quat([*xyz, w]).as_matrix())
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ torch.tensor(self.position, dtype=torch.float64)
        focal = height / 2 / math.tan(self.fov / 2)
        intrinsics = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
        return Cameras(pose[None].float(), intrinsics, width, height, ("view",))


@dataclass(frozen=True, eq=False)
class Limits:
    """Where there is something to see: from where cameras saw it, turned to the anchors. Beyond are fog and nothing.

    Attributes:
        cameras: Places of the cameras, seen from what they look at; C x 3.
        aside: Largest angle from the direction of the closest of them, radians.
        targets: Lowest and highest corner of the box in which there is something to turn around; 2 x 3.
    """

    cameras: np.ndarray
    aside: float
    targets: np.ndarray

    @property
    def nearest(self) -> float:
        """Least distance from what the view turns around."""
        return NEAREST * float(np.linalg.norm(self.cameras, axis=1).min())

    @property
    def farthest(self) -> float:
        """Largest distance from what the view turns around."""
        return FARTHEST * float(np.linalg.norm(self.cameras, axis=1).max())

    def within(self, position: Triple, look_at: Triple) -> tuple[Triple, Triple]:
        """The closest place from which one may look, and what to turn around there."""
        target, away = np.clip(look_at, *self.targets), np.subtract(position, look_at)
        cosines = _unit(self.cameras) @ _unit(away)
        camera = self.cameras[cosines.argmax()]
        direction, side = _unit(away), _unit(camera)
        if math.acos(min(max(float(cosines.max()), -1.0), 1.0)) > self.aside:
            across = _unit(direction - cosines.max() * side)
            direction = math.cos(self.aside) * side + math.sin(self.aside) * across
        distance = min(max(float(np.linalg.norm(away)), NEAREST * float(np.linalg.norm(camera))), self.farthest)
        return _triple(target + distance * direction), _triple(target)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


@dataclass(frozen=True)
class FirstLook:
    """Where an orbit control starts, and how far it goes.

    Attributes:
        position: Of the camera.
        look_at: What it turns around.
        up: Which way is up.
        fov: Vertical field of view, radians.
        limits: Where it may go.
    """

    position: Triple
    look_at: Triple
    up: Triple
    fov: float
    limits: Limits

    def look(self, aspect: float) -> Look:
        """The first picture's point of view."""
        forward = np.subtract(self.look_at, self.position)
        right = np.cross(forward, self.up)
        axes = _unit(np.stack([right, np.cross(forward, right), forward]))
        x, y, z, w = Rotation.from_matrix(axes.T).as_quat().tolist()
        return Look(self.position, (w, x, y, z), self.fov, aspect)


def first_look(positions: Float[Tensor, "N 3"], cameras: Cameras | None) -> FirstLook:
    """Chooses where to begin.

    Args:
        positions: The anchors of the scene; their median is what the view turns around.
        cameras: Cameras that saw the scene: the first of them is taken, and up is what they agree on. None looks at
            the scene from the outside, with the world's -y axis up, as photo datasets mostly have it.
    """
    seen = cameras_around(positions, num_views=8) if cameras is None else cameras
    view = seen.num_views // 2 if cameras is None else 0
    positions, pose, centers = positions.double(), seen.viewmats.double(), seen.centers.double()
    middle, center, forward = positions.median(dim=0).values, centers[view], pose[view, 2, :3]
    distance = max(float((middle - center) @ forward), 0.1 * float((middle - center).norm()), 1e-3)
    up = -pose[:, 1, :3].mean(dim=0) if cameras is not None else torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    up = up / up.norm() if float(up.norm()) > 1e-6 else up * 0
    if float(torch.linalg.cross(up, forward).norm()) < 1e-3:  # no agreement, or the first one looks along it
        up = -pose[view, 1, :3]
    fov = 2 * math.atan(seen.height / 2 / float(seen.Ks[view, 1, 1]))
    look_at = center + distance * forward
    inner = np.quantile(positions.numpy(), [0.5 - SPREAD / 2, 0.5 + SPREAD / 2], axis=0)
    targets = np.stack([np.minimum(inner[0], look_at.numpy()), np.maximum(inner[1], look_at.numpy())])
    limits = Limits((centers - look_at).numpy(), math.pi if cameras is None else ASIDE, targets)
    return FirstLook(_triple(center), _triple(look_at), _triple(up), fov, limits)


def _triple(vector: Tensor | np.ndarray) -> Triple:
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
