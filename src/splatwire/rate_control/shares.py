"""Search for the share of Gaussians to keep before fine-tuning, so that the stream has the wanted size or PSNR."""

import math
from collections.abc import Callable

from splatwire.rate_control.search import Interval

TUNINGS = 3
"""Maximum number of fine-tunings."""
MIN_CHANGE = 0.02
"""Minimum change of the logarithm of the share between two fine-tunings."""
MAX_CHANGE = 0.5
"""Maximum change of the logarithm of the share between two fine-tunings."""


def search_share(tune: Callable[[float], float], target: Interval, start: float, slope: float) -> int:
    """Fine-tunes a scene with different shares of its Gaussians, until the result has a wanted size or PSNR.

    Args:
        tune: Function that fine-tunes a given share of the Gaussians. It returns a value that grows with the share: the
            PSNR or the logarithm of the size.
        target: Range of accepted values of `tune`.
        start: First share, above 0 and at most 1.
        slope: Expected increase of the value per unit of the logarithm of the share, above 0.

    Returns:
        Index of the best call of `tune`, counted from 0. Among the calls with a value in the range or above it, the
        best is the call with the smallest share. If all values are below the range, it is the call with the largest
        value.
    """
    logs, values, at = [], [], math.log(start)
    while True:
        logs.append(at)
        values.append(tune(math.exp(at)))
        if len(values) > 1:
            measured = (values[-1] - values[-2]) / (logs[-1] - logs[-2])
            if math.isfinite(measured):  # views without any difference have infinite PSNR
                slope = min(max(measured, slope / 2), 2 * slope)
        step = min(max((target.wanted - values[-1]) / slope, -MAX_CHANGE), MAX_CHANGE)
        reaching = [log for log, value in zip(logs, values, strict=True) if value >= target.low]
        missing = [log for log, value in zip(logs, values, strict=True) if value < target.low]
        low, high = max(missing, default=-math.inf) + MIN_CHANGE, min(reaching, default=0.0)
        following = min(max(at + step, low), high)
        done = values[-1] in target or len(values) == TUNINGS
        if done or min(abs(following - log) for log in logs) < MIN_CHANGE:
            break
        at = following
    return logs.index(high) if reaching else values.index(max(values))
