"""Detection of PLY columns that are probably not in the units of a 3DGS PLY, by the range of their values.

A 3DGS PLY has logits of opacities, logarithms of scales, and coefficients of harmonics. Some programs write linear
opacities, scales and colours instead.
"""

import logging
import re
from pathlib import Path

import numpy as np

from splatwire.io.formats._columns import MAX_LOG_SCALE
from splatwire.io.formats.ply_file import PlyElement

LOG = logging.getLogger(__name__)
_PARTS = re.compile(r"(?:f_dc|f_rest|scale|rot)_\d+|[xyz]")
_MIN_ROWS = 4
"""Minimum number of Gaussians for warnings about opacities or colours alone; fewer may have any values."""
_MAX_LOGIT = 30.0
"""Largest plausible logit; float32 rounds the opacity of a logit above 17 to 1."""
_OUTSIDE = 0.01
"""Maximum share of opacities outside of the expected range; some programs do not limit them exactly."""
_MAX_SIZE = 0.25
"""Largest plausible ratio of the median size of Gaussians to the extent of a scene."""
_SKEWED = 0.05
"""Ratio of minimum to median of positive scales; lower ratios are typical of sizes."""
_SPREAD_QUANTILES = (0.05, 0.95)
_NEAR_END = 0.1
"""Largest distance of the extreme values of `f_dc_*` from 0 and 1 if they are colours from 0 to 1."""
_MAX_COLOUR = 10.0
"""Largest plausible median of the coefficients of colours; colours from 0 to 1 have coefficients up to 1.8."""


def warn_of_other_units(vertices: PlyElement) -> None:
    """Logs a warning if values in a PLY seem to have other units than expected.

    Expected are opacities as logits, scales as logarithms, and colours as coefficients of spherical harmonics.

    Raises:
        DatasetError: If a property is missing.
    """
    sample = vertices.sample()
    opacities, scales = sample.select_float64(["opacity"])[:, 0], sample.columns("scale_", 3).astype(np.float64)
    opacities, scales = opacities[~np.isnan(opacities)], scales[~np.isnan(scales)]
    meant = _unit_of_opacities(sample, opacities)
    positive = bool(scales.size) and scales.min() >= 0
    several = len(sample.rows) >= _MIN_ROWS
    are_sizes = positive and (meant is not None or (len(sample.rows) > 1 and _look_like_sizes(sample, scales, several)))
    if are_sizes:
        _warn_of_scales(vertices.path, scales)
    if meant is not None and (several or are_sizes):
        _warn_of_opacities(vertices.path, opacities, meant)
    if several:
        _warn_of_colours(vertices.path, sample)
    _warn_of_integers(sample)


def _warn_of_integers(sample: PlyElement) -> None:
    """Logs a warning about integer properties, which are probably quantised values with an unknown step.

    Args:
        sample: A sample of the vertices.
    """
    whole = [name for name in sample.names if sample.rows.dtype[name].kind in "ui" and _PARTS.fullmatch(name)]
    if whole:
        LOG.warning(
            "%s: properties %s are integers, so they may be quantised; they are read as they are: write floats",
            sample.path, ", ".join(whole)[:200],
        )  # fmt: skip


def _look_like_sizes(sample: PlyElement, scales: np.ndarray, several: bool) -> bool:
    """True if the scales in a file are probably sizes instead of logarithms of sizes.

    Args:
        sample: A sample of the vertices.
        scales: Scales of the sample, all at least 0, without NaN.
        several: True if there are enough values to judge the distribution.
    """
    # as logarithms, these would be too large for the scene, all from 0 to 1, or have a minimum far below the median
    low, middle, high = float(scales.min()), float(np.median(scales)), float(scales.max())
    if np.exp(min(middle, MAX_LOG_SCALE)) > _MAX_SIZE * _extent(sample):
        return True
    return several and low < high and (low < _SKEWED * middle or high <= 1)


def _warn_of_scales(path: Path, scales: np.ndarray) -> None:
    low, high = float(scales.min()), float(scales.max())
    LOG.warning(
        "%s: all scales are from %.4g to %.4g, so they may be linear; they are read as logarithms, which gives "
        "sizes from %.4g to %.4g: write log(scale)",
        path, low, high, *np.exp(np.minimum([low, high], MAX_LOG_SCALE)),
    )  # fmt: skip


def _extent(sample: PlyElement) -> float:
    """Returns the extent of the scene along its longest axis, without outliers, world units.

    Args:
        sample: A sample of the vertices.
    """
    means = sample.select_float64(["x", "y", "z"])
    means = means[np.isfinite(means).all(axis=1)]
    if not len(means):
        return 0.0
    low, high = np.quantile(means, _SPREAD_QUANTILES, axis=0)
    return float((high - low).max())


def _unit_of_opacities(sample: PlyElement, values: np.ndarray) -> str | None:
    """Guesses the form in which a file stores opacities.

    Args:
        sample: A sample of the vertices.
        values: Opacities of the sample, without NaN.

    Returns:
        Description for a warning, such as `linear`; None for logits, which are expected.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    low, high = np.quantile(values, (_OUTSIDE, 1 - _OUTSIDE), method="nearest")
    if low >= 0 and 0 < high <= 1 and (low < high or high == 1 or len(sample.rows) < _MIN_ROWS):
        return "linear"
    if values.min() >= 0 and (np.quantile(finite, _SPREAD_QUANTILES[1]) > _MAX_LOGIT or _are_bytes(sample, finite)):
        return "from 0 to 255 or another maximum"
    return None


def _warn_of_opacities(path: Path, values: np.ndarray, meant: str) -> None:
    low, high = float(values.min()), float(values.max())
    read = 1 / (1 + np.exp(-np.clip([low, high], -MAX_LOG_SCALE, MAX_LOG_SCALE)))
    LOG.warning(
        "%s: all opacities are from %.4g to %.4g, so they may be %s; they are read as logits, which gives "
        "opacities from %.2g to %.2g: write log(opacity / (1 - opacity)) with opacities from 0 to 1",
        path, low, high, meant, *read,
    )  # fmt: skip


def _are_bytes(sample: PlyElement, values: np.ndarray) -> bool:
    """True if opacities are probably integer codes, such as bytes, and not logits.

    Args:
        sample: A sample of the vertices.
        values: Finite opacities of the sample.
    """
    if sample.rows.dtype["opacity"].kind in "ui":
        return True
    whole = np.unique(values)
    return len(whole) > 2 and bool((whole == np.floor(whole)).all())


def _warn_of_colours(path: Path, sample: PlyElement) -> None:
    if sample.count_of("f_dc_") != 3:
        return
    values = sample.columns("f_dc_", 3).astype(np.float64)
    values = values[np.isfinite(values)]
    if not values.size or values.min() < 0:
        return
    if values.min() < _NEAR_END and 1 - _NEAR_END < values.max() <= 1:
        LOG.warning(
            "%s: all properties f_dc_* are from %.4g to %.4g, so they may be colours from 0 to 1; they are read as "
            "coefficients of harmonics: write (colour - 0.5) / 0.28209479",
            path, values.min(), values.max(),
        )  # fmt: skip
    if np.median(values) <= _MAX_COLOUR:
        return
    LOG.warning(
        "%s: all properties f_dc_* are from %.4g to %.4g, so they may be colours from 0 to 255; they are read as "
        "coefficients of harmonics: write (colour / 255 - 0.5) / 0.28209479",
        path, values.min(), values.max(),
    )  # fmt: skip
