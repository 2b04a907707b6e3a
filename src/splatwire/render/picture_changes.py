"""Estimates of how much each changed Gaussian alters the rendered pictures."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from splatwire.ops.twister import Twister
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.precision import BRIGHTEST
from splatwire.types import Cameras
from splatwire.types.gaussians import Gaussians
from splatwire.types.splats import Splats


def picture_changes(before: Splats, after: Splats, cameras: Cameras, seed: int = 0) -> Float64[np.ndarray, "G"]:
    """Estimates how much the change of each Gaussian alters rendered pictures.

    Args:
        before: Gaussians before the change.
        after: These Gaussians after the change; Gaussian i of `before` is Gaussian i of `after`.
        cameras: Cameras of the pictures.
        seed: Random seed.

    Returns:
        For each Gaussian, squared differences of colour values, summed over all pixels; 0 outside of all pictures.
    """
    # To first order, a pixel changes by its derivatives times the changes of the attributes. For the sum of all pixels
    # with random signs, the expected square of this product is the sum of the squares of all pixels. See
    # `splatwire.render.pruning`.
    rng, changes = Twister(seed), np.zeros(after.num_gaussians)

    def signs(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
        yield rng.signs(shape)

    for view in range(cameras.num_views):
        centre = cameras.centers[view]
        old, new = (_limited(splats.seen_from(centre)) for splats in (before, after))
        differences = [getattr(new, name) - values for name, values in vars(old).items()]

        def add(rows: slice, *gradients: np.ndarray, differences: list[np.ndarray] = differences) -> None:
            products = (
                (each * values[rows]).reshape(len(each), -1).sum(axis=1, dtype=np.float64)
                for each, values in zip(gradients, differences, strict=True)
            )
            changes[rows] += sum(products) ** 2

        each_gradient_cpu(new, cameras.select([view]), signs, add)
    return changes


def _limited(seen: Gaussians) -> Gaussians:
    """Returns the Gaussians of a view with colours limited to `BRIGHTEST`.

    Without the limit, a Gaussian of extreme colour would dominate the estimated changes of the pixels that it covers.
    """
    return replace(seen, colors=np.minimum(seen.colors, np.float32(BRIGHTEST)))
