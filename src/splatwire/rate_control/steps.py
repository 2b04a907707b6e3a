"""Choice of the quantisation precision of each attribute of the Gaussians, by measurements in the encoded scene."""

# The fixed ratios of quantisation steps in `splatwire.codec.gaussians.quality` suit an average scene.

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Int8, Int64

from splatwire.bitstream import SceneStream
from splatwire.codec.gaussians.layout import STEPS
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.finetuning.latents import Latents, RoundingErrors
from splatwire.ops.kd_order import kd_order
from splatwire.rate_control.views import SourcePictures
from splatwire.types import Cameras, SplatScene

_GROUPS = {
    "logits": ("opacity",),
    "logs": ("scale0", "elongation", "flatness"),
    "means": ("position",),
    "quats": ("direction", "spin"),
    "base": ("colour",),
    "harmonics": ("harmonics",),
}
"""Attributes by their name in `RoundingErrors`, and the quantities of `STEPS` whose steps determine their precision."""
_MAX_OCTAVES = 3.0
"""Maximum change of the precision of an attribute, octaves."""
_MAX_COLOUR = 2
"""Maximum change of the precision of base colours that `measured_colour_precision` tries, octaves."""
_FINEST_LEVEL, _FINEST_PRECISION = 24.0, 16.0
"""Upper limits of `Quality.level` and `Quality.precision`."""
_MIN_GAIN = 0.01
"""Minimum gain of an octave of precision of base colours: decrease of the logarithm of bytes at equal PSNR."""
_MAX_DB = 120.0
"""Maximum PSNR of a picture, so that means are finite, decibels."""
_RUNS, _RUN = 4, 4096
"""Number of spatially compact groups of Gaussians that are encoded to measure bytes, and Gaussians per group."""
_MIN_RATE = 1e-3
"""Minimum share of an attribute in the bytes that one more octave of precision of all attributes takes."""
_MIN_ERROR = 1e-12
"""Minimum squared error of a picture, so that shares of the error are finite."""


def measured_precision(
    scene: SplatScene,
    class_offsets: Int8[np.ndarray, "N"],
    quality: Quality,
    cameras: Cameras,
    encode: Callable[[SplatScene, np.ndarray, Quality], SceneStream],
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[float, ...]:
    """Chooses the precision of each attribute, so that pictures of equal PSNR take as few bytes as possible.

    Args:
        scene: The Gaussians.
        class_offsets: Class offset of each Gaussian: 0 for the finest quantisation steps, negative for coarser ones.
        quality: Quality setting at which attributes are measured.
        cameras: Views for measuring errors.
        encode: Function that encodes a scene.
        progress: Called with the finished share of the work.

    Returns:
        The additional precision of each quantity in `STEPS`, for `Quality.precision`. The unit is octaves: one octave
        halves the quantisation step.
    """
    # For each attribute, two things are measured: the image error if only this attribute is rounded, and the bytes
    # that one octave of its precision takes. An octave divides the error by 4. Bytes are fewest if the error of
    # each attribute is proportional to its bytes per octave. The sum of the errors stays the same.
    latents, precision = Latents.of(scene.splats), np.array(quality.precision)
    exact = latents.splats()
    rounding_errors = RoundingErrors.between(exact, round_splats(exact, coding_for(exact, quality, class_offsets)))
    names = [name for name in _GROUPS if getattr(rounding_errors, name).size]
    groups = [[STEPS.index(step) for step in _GROUPS[name]] for name in names]
    pictures = SourcePictures(replace(scene, splats=exact), cameras)
    rows = _sample(scene)
    subset, some_offsets = scene.select(rows), class_offsets[rows]

    def size(group: list[int], octaves: float) -> int:
        changed = precision.copy()
        changed[group] += octaves
        return encode(subset, some_offsets, replace(quality, precision=tuple(changed.tolist()))).num_bytes

    errors, rates = np.empty((len(names), cameras.num_views)), np.empty(len(names))
    for index, (name, group) in enumerate(zip(names, groups, strict=True)):
        drawn = replace(scene, splats=latents.splats(_only(rounding_errors, name)), coding=None, hints=None)
        errors[index] = np.maximum(10 ** (-pictures.psnr(drawn) / 10), _MIN_ERROR)
        rates[index] = (size(group, 1.0) - size(group, -1.0)) / 2
        progress((index + 1) / len(names))
    # The mean PSNR depends on the shares of the error of each view.
    shares = (errors / errors.sum(axis=0)).mean(axis=1)
    rates = np.maximum(rates, _MIN_RATE * np.maximum(rates, 1.0).sum())
    for group, octaves in zip(groups, np.log2(shares * rates.sum() / rates) / 2, strict=True):
        precision[group] = np.clip(precision[group] + octaves, -_MAX_OCTAVES, _MAX_OCTAVES)
    return tuple(precision.tolist())


def measured_colour_precision(
    scene: SplatScene,
    class_offsets: Int8[np.ndarray, "N"],
    quality: Quality,
    cameras: Cameras,
    encode: Callable[[SplatScene, np.ndarray, Quality], SceneStream],
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[float, ...]:
    """Chooses the precision of base colours, so that pictures of equal PSNR take as few bytes as possible.

    Base colours get at least the precision of `quality`. All other attributes get exactly this precision. Arguments and
    result are those of `measured_precision`.
    """
    # Whole octaves are tried. PSNR is converted to bytes with the ratio that finer steps of all attributes have.
    # Coarser colours are not tried: with them, a scene of degree 3 took 2 to 28 % more bytes.
    pictures, rows = SourcePictures(scene, cameras), _sample(scene)
    subset, some_offsets, base = scene.select(rows), class_offsets[rows], STEPS.index("colour")

    def outcome(tried: Quality) -> tuple[float, float]:
        rounded = round_splats(scene.splats, coding_for(scene.splats, tried, class_offsets))
        decibels = pictures.psnr(replace(scene, splats=rounded, coding=None, hints=None))
        size = encode(subset, some_offsets, tried).num_bytes
        return math.log(size), float(np.minimum(decibels, _MAX_DB).mean())

    def changed(octaves: int) -> Quality:
        precision = np.array(quality.precision)
        precision[base] = min(precision[base] + octaves, _FINEST_PRECISION)
        return replace(quality, precision=tuple(precision.tolist()))

    size, decibels = outcome(quality)
    finer_size, finer_decibels = outcome(replace(quality, level=min(quality.level + 1, _FINEST_LEVEL)))
    progress(0.5)
    if finer_decibels <= decibels:
        return quality.precision
    price = (finer_size - size) / (finer_decibels - decibels)
    octaves, cost = 0, size - price * decibels
    while octaves < _MAX_COLOUR:
        size, decibels = outcome(changed(octaves + 1))
        if size - price * decibels > cost - _MIN_GAIN:
            break
        octaves, cost = octaves + 1, size - price * decibels
    progress(1.0)
    return changed(octaves).precision


def _only(rounding_errors: RoundingErrors, name: str) -> RoundingErrors:
    """Returns a copy of rounding errors without the errors of all attributes but one.

    Args:
        rounding_errors: Rounding errors of all attributes.
        name: Name of the attribute that keeps its error.
    """
    none = {each: np.zeros_like(values) for each, values in vars(rounding_errors).items()}
    none["quats"][:, 0] = 1
    return RoundingErrors(**{**none, name: getattr(rounding_errors, name)})


def _sample(scene: SplatScene) -> Int64[np.ndarray, "M"]:
    """Returns the ascending indices of a sample of Gaussians: a few compact groups, or all of a small scene."""
    # All Gaussians of a small scene.
    count = scene.num_elements
    if count <= _RUNS * _RUN:
        return np.arange(count)
    bounds = np.append(np.arange(0, count, _RUN), count)
    order = kd_order(scene.splats.means, [bounds])
    runs = np.linspace(0, len(bounds) - 2, 2 * _RUNS + 1)[1::2].round().astype(int).tolist()
    return np.sort(np.concatenate([order[bounds[run] : bounds[run + 1]] for run in runs]))
