"""Where a clip goes: a ball in which nearly all of each of its frames is, so that a camera can begin where all fits."""

from dataclasses import dataclass

import numpy as np

from splatwire.ops.arrays import lower_median
from splatwire.scene.splats import Splats

SAMPLES = 6000
FAINT = 0.1
"""What is fainter is no part of what has to fit."""
NEARLY_ALL, REACH = 0.998, 5.0
"""A frame ends where so many Gaussians lie nearer to its middle, at most at so many times the distance of half."""


@dataclass(frozen=True)
class Ball:
    """A ball.

    Attributes:
        middle: float64 (3), world units.
        radius: World units.
    """

    middle: np.ndarray
    radius: float

    def with_(self, other: "Ball") -> "Ball":
        """The smallest ball around both."""
        apart = float(np.linalg.norm(other.middle - self.middle))
        if apart + other.radius <= self.radius:
            return self
        if apart + self.radius <= other.radius:
            return other
        radius = (apart + self.radius + other.radius) / 2
        return Ball(self.middle + (other.middle - self.middle) * ((radius - self.radius) / apart), radius)


def ball_of(splats: Splats) -> Ball | None:
    """A ball around nearly all of some Gaussians, from a sample of them; None around none."""
    if not splats.num_gaussians:
        return None
    few = slice(None, None, -(-splats.num_gaussians // SAMPLES))
    means, seen = splats.means[few].astype(np.float64), splats.opacities[few] >= FAINT
    return ball_around(means[seen] if bool(seen.any()) else means)


def ball_around(positions: np.ndarray) -> Ball:
    """A ball around nearly all of some places, (n, 3), n > 0: its middle is their median."""
    middle = lower_median(positions)
    away = np.linalg.norm(positions - middle, axis=1)
    last = np.sort(away)[int(np.ceil(NEARLY_ALL * len(away))) - 1]
    return Ball(middle.astype(np.float64), min(float(last), REACH * float(lower_median(away))))
