"""Registry of image quality metrics, open to installed packages (docs/your-own-concealer.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.metrics.psnr import psnr
from splatwire.metrics.ssim import ssim
from splatwire.plugins import Registry, source_of

GROUP = "splatwire.metrics"
"""Entry-point group of metrics in other packages."""
Measure = TypeVar("Measure", bound=Callable[..., Any])


@dataclass(frozen=True)
class Metric:
    """A metric of image quality.

    Attributes:
        measure: Function that returns the metric of each of C views. Its arguments are images and references, float32
            (C, H, W, 3), RGB in [0, 1], and masks of the evaluated pixels, bool (C, H, W), or None. `measure` is None
            for LPIPS, which has a separate class.
        label: Name in tables.
        digits: Decimal places in tables.
    """

    measure: Callable[..., Any] | None
    label: str
    digits: int


METRICS: Registry[Metric] = Registry("metric", GROUP)
METRICS.register("psnr", Metric(psnr, "PSNR", 2), source_of(psnr))
METRICS.register("ssim", Metric(ssim, "SSIM", 4), source_of(ssim))
METRICS.register("lpips", Metric(None, "LPIPS", 4), "splatwire.metrics.lpips.Lpips")
METRICS.register("lpips_unscaled", Metric(None, "LPIPS [0, 1]", 4), "splatwire.metrics.lpips.Lpips")
LPIPS_SCALED = {"lpips": True, "lpips_unscaled": False}
"""Metrics that need LPIPS weights, with the value of `scaled` of `splatwire.metrics.lpips.Lpips.features`."""
PUBLISHED_LPIPS = "lpips_unscaled"
"""Variant of LPIPS in the tables of 3DGS, Scaffold-GS, HAC++ and the codecs that use their code."""


@checked
def register_metric(name: str, *, label: str | None = None, digits: int = 4) -> Callable[[Measure], Measure]:
    """Decorator that registers a function that compares images.

    Arguments of the function: see `Metric.measure`.

    Args:
        name: Name of the metric: letters, digits and underscores.
        label: Name in tables; defaults to `name`.
        digits: Decimal places in tables.

    Raises:
        InvalidValueError: If the name is taken or is not an identifier, or the decorated object is not callable.
    """

    def register(measure: Measure) -> Measure:
        if not callable(measure):
            raise InvalidValueError(f"metric '{name}' is a {type(measure).__name__}, not a function")
        if not str(name).isidentifier():
            raise InvalidValueError(f"{name!r} cannot be the name of a metric: take letters, digits and underscores")
        METRICS.register(name, Metric(measure, label or name, digits), source_of(measure))
        return measure

    return register


def measure_view(name: str, image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None) -> float:
    """Computes a metric for one view.

    Args:
        name: Name of the metric.
        image: RGB in [0, 1], float32 (1, H, W, 3).
        reference: RGB in [0, 1], float32 (1, H, W, 3).
        mask: True for pixels that count, bool (1, H, W); None for all.

    Raises:
        UnknownNameError: If no metric has that name.
        InvalidValueError: If the metric returns NaN, or not exactly one number.
    """
    measure = METRICS[name].measure
    assert measure is not None
    value = np.asarray(measure(image, reference, mask))
    if value.shape != (1,) or value.dtype.kind not in "fiu" or bool(np.isnan(value[0])):
        shown = f"{value.dtype} of shape {value.shape}" if value.shape != (1,) else f"{value[0]!r}"
        whose = f"metric '{name}'{METRICS.provider_suffix(name)}"
        raise InvalidValueError(f"{whose} returned {shown} for one view, not a number")
    return float(value[0])
