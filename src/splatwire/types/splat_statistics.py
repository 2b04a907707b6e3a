"""Statistics of a file of explicit Gaussians: extent, sizes, opacities, and likely defects."""

from typing import Any

import numpy as np

from splatwire.ops.spherical_harmonics import DC
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

_FAINT = 1 / 255
"""Opacity below which a Gaussian changes no pixel of an 8-bit image."""
_CORE_PERCENT = 1.0
"""Percentage of the Gaussians excluded at each end of each axis; the remaining extent is the core of the scene."""
_FAR, _THIN = 100.0, 1e4
"""Distance from the centre, in multiples of the core's size, above which a Gaussian is reported as far;
ratio of largest to smallest standard deviation above which it is reported as a needle."""
_COLOURS = (-1.0, 2.0)
"""Range of plausible view-independent colours; images show 0 to 1."""


def describe_gaussians(splats: Splats, origin: Origin = NO_ORIGIN) -> dict[str, Any]:
    """Computes statistics of explicit Gaussians.

    Args:
        splats: The Gaussians; if empty, only their number and degree of harmonics are returned.
        origin: World coordinates of the point that positions are relative to.

    Returns:
        Statistics by name:

        * `num_gaussians`: number of Gaussians.
        * `degree`: degree of the harmonics.
        * `bounds`: box around all centres, world coordinates.
        * `core`: box around the middle 98 % of the centres on each axis, world coordinates.
        * `sizes`: quantiles of the largest standard deviation of each Gaussian, world units.
        * `opacities`: quantiles of the opacities.
        * `problems`: list of sentences about likely defects.
    """
    if not splats.num_gaussians:
        return {"num_gaussians": 0, "degree": splats.degree, "problems": ["no Gaussian is left"]}
    means, scales = splats.means.astype(np.float64), splats.scales.astype(np.float64)
    opacities = splats.opacities.astype(np.float64)
    low, high = np.percentile(means, [_CORE_PERCENT, 100 - _CORE_PERCENT], axis=0)
    return {
        "num_gaussians": splats.num_gaussians,
        "degree": splats.degree,
        "bounds": _box(means.min(axis=0) + np.array(origin), means.max(axis=0) + np.array(origin)),
        "core": _box(low + np.array(origin), high + np.array(origin)),
        "sizes": _quantiles(scales.max(axis=1)),
        "opacities": _quantiles(opacities),
        "problems": _problems(splats, means, scales, opacities, float(np.linalg.norm(high - low))),
    }


def _problems(
    splats: Splats, means: np.ndarray, scales: np.ndarray, opacities: np.ndarray, core: float
) -> list[str]:  # fmt: skip
    middle = np.median(means, axis=0)
    constant = splats.sh[:, 0].astype(np.float64) * DC + 0.5
    masks = {
        f"farther from the middle than {_FAR:g} times the core": np.linalg.norm(means - middle, axis=1) > _FAR * core,
        "larger than the core": scales.max(axis=1) > core,
        f"more than {_THIN:g} times as long as thick": scales.max(axis=1) > _THIN * scales.min(axis=1),
        "too transparent to be seen (opacity below 1/255)": opacities < _FAINT,
        f"of a colour outside {_COLOURS[0]:g} to {_COLOURS[1]:g}": (
            (constant < _COLOURS[0]) | (constant > _COLOURS[1])
        ).any(axis=1),
    }
    remarks = [
        f"{problem}: {int(rows.sum()):,} of {len(rows):,}, first row {int(rows.argmax())}"
        for problem, rows in masks.items()
        if rows.any()
    ]
    if len(means) > 1 and core == 0:
        remarks.append("nearly all Gaussians are at one place")
    if splats.degree and not bool(splats.sh[:, 1:].any()):
        remarks.append(f"the harmonics of degree {splats.degree} are all 0: they cost bytes for nothing")
    return remarks


def _box(low: np.ndarray, high: np.ndarray) -> dict[str, list[float]]:
    return {axis: [float(a), float(b)] for axis, a, b in zip("xyz", low, high, strict=True)}


def _quantiles(values: np.ndarray) -> dict[str, float]:
    named = {"least": 0, "1 %": 1, "median": 50, "99 %": 99, "most": 100}
    return dict(zip(named, map(float, np.percentile(values, list(named.values()))), strict=True))
