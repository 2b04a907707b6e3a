"""How precise each of a scene's Gaussians must be: one number that explains nearly all of what pictures depend on.

The squared error of pictures for a change of a Gaussian is, to first order, its squared gradient. Between Gaussians it
differs by orders of magnitude, mostly by how much of each is seen, and alike for all of its attributes once its shape
is taken into account; so each gets one class, an octave of step sizes.
"""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from splatwire.model.appearance import Scene, explicit_gaussians, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.ops.kd_order import kd_order
from splatwire.ops.rising import rising
from splatwire.ops.threads import share
from splatwire.ops.twister import Twister
from splatwire.render._precision_kernels import NUM_SUMS, add_squared
from splatwire.render.backends import gradient_source
from splatwire.render.importance import cameras_around
from splatwire.scene import Cameras
from splatwire.scene.splats import Splats

PART = 1 << 18
"""So many Gaussians are looked at together: memory and time for each do not grow with the scene."""
VIEWS, VIEWS_OF_PART, SIZE = 12, 6, 224
"""Views around a scene, or around one of its parts, and their width and height in pixels."""
FINEST_SHARE = 0.98
"""Classes count down from this quantile."""
BRIGHTEST = 4.0
"""Colours count as no brighter than this, which is the most that a view of five real files has: one absurd colour would
else decide how precise all Gaussians are that it shines through."""
_UNSEEN = 1e-30
_SHAPE = ("scale0", "scale1", "scale2", "direction", "spin")
_MOST_THIN, _MOST_SMALL = 10.0, 16.0
"""Octaves from an axis of a Gaussian to the next one, and from its size to the usual one, that slopes hold for."""
# In the order of the kernel's columns.
_SLOPES = {
    "position": (-0.33, -0.2, 0.0, 0.0),
    "scale0": (0.25, 0.0, -0.25, 0.2),
    "scale1": (0.25, -1.0, 0.0, 0.2),
    "scale2": (0.25, -0.8, -1.5, 0.2),
    "direction": (0.25, 1.6, 1.1, 0.25),
    "spin": (0.3, 0.8, 2.4, 0.25),
    "opacity": (0.0, -0.2, -0.1, 0.0),
    "colour": (0.0, 0.0, 0.0, 0.0),
}
"""Octaves of sensitivity for an octave of area, of s0 / s1, of s1 / s2 and of opacity (least squares, three scenes)."""
_BASES = {
    "position": -0.8, "scale0": 1.2, "scale1": 1.0, "scale2": 1.0, "direction": -1.0, "spin": -3.0, "opacity": -2.3,
    "colour": 0.0,
}  # fmt: skip
_WEIGHTS = {
    "position": 3.0, "scale0": 1.0, "scale1": 1.0, "scale2": 1.0, "direction": 2.0, "spin": 0.7, "opacity": 1.0
}  # fmt: skip
"""Numbers that each attribute has; colour has 3, and about 12 with harmonics."""


def classes_of(scene: Scene, cameras: Cameras | None = None, *, anew: bool = False) -> np.ndarray | None:
    """Classes of precision of a scene's elements; None where it has steps: as trained anchors and decoded Gaussians do.

    Args:
        scene: The scene.
        cameras: Where it is looked at from; None for views around it.
        anew: Whether steps that the Gaussians have do not count.
    """
    splats = explicit_gaussians(scene)
    return (
        None
        if splats is None or (getattr(scene, "coding", None) is not None and not anew)
        else precision_classes(splats, None if cameras is None else cameras.relative_to(origin_of(scene)))
    )


def precision_classes(
    splats: Splats, cameras: Cameras | None = None, *, probes: int = 1, seed: int = 0, renderer: str = "cpu",
    part: int = PART,
) -> np.ndarray:  # fmt: skip
    """Sorts Gaussians into classes of precision.

    Args:
        splats: The Gaussians.
        cameras: Where they are looked at from; None for 12 views around them, or, where there are several parts, 6
            around each.
        probes: Random sign patterns for each view.
        seed: Of the signs.
        renderer: Name of a differentiable renderer.
        part: Gaussians that are looked at together at most, without cameras: a part of space alone.

    Returns:
        int8 (N): 0 for the finest, -1 for those that may be an octave coarser, and so on; a few are above 0.
    """
    count = -(-splats.num_gaussians // part)
    if cameras is not None or count < 2:
        cameras = cameras if cameras is not None else cameras_around(splats.means, VIEWS, SIZE)
        return _classes(splats, cameras, probes, seed, renderer)
    edges = np.arange(count + 1, dtype=np.int64) * splats.num_gaussians // count
    order, classes = kd_order(splats.means, [edges]), np.empty(splats.num_gaussians, np.int8)

    def look(ends: tuple[int, int]) -> None:
        members = np.sort(order[slice(*ends)])
        some = splats.select(members)
        around = cameras_around(some.means, VIEWS_OF_PART, SIZE)
        classes[members] = _classes(some, around, probes, seed, renderer)

    share(look, list(itertools.pairwise(edges.tolist())))
    return classes


def _classes(splats: Splats, cameras: Cameras, probes: int, seed: int, renderer: str) -> np.ndarray:
    found = _sensitivities(splats, cameras, probes, seed, renderer)
    low, middle, high = (np.log2(scales.astype(np.float64)) for scales in rising(splats.scales))
    least = np.median(high) - _MOST_SMALL
    size, width = np.maximum(high, least), np.maximum(middle, np.maximum(high, least) - _MOST_THIN)
    area, long, thin = size + width, size - width, np.minimum(np.maximum(width - low, 0), _MOST_THIN)
    shape = np.stack([area, long, thin, np.log2(np.maximum(splats.opacities.astype(np.float64), 1 / 512))])
    weights = {**_WEIGHTS, "colour": 12.0 if splats.degree else 3.0}
    # Of flat disks, needles and points only what their missing axes leave alone says how much of them is seen.
    odd = (high < least) | (middle < size - _MOST_THIN) | (low < width - _MOST_THIN)
    octaves, total = np.zeros(splats.num_gaussians), np.full(splats.num_gaussians, sum(weights.values()))
    for name, weight in weights.items():
        own = weight * (np.log2(found[name] + _UNSEEN) / 2 - _BASES[name] - np.array(_SLOPES[name]) @ shape)
        if name in _SHAPE:
            own[odd] = 0
            total[odd] -= weight
        octaves += own
    octaves /= total
    finest = np.quantile(octaves, FINEST_SHARE)
    return np.rint(octaves - finest).clip(-100, 100).astype(np.int8)


def _sensitivities(
    splats: Splats, cameras: Cameras, probes: int, seed: int, renderer: str
) -> dict[str, Float64[np.ndarray, "G"]]:
    """Mean squared change of pictures for each attribute, per scalar: squared gradients of random signs."""
    rng, num = Twister(seed), splats.num_gaussians
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    low, middle, high = np.log2(np.stack(rising(splats.scales)))
    spun = np.where(middle - low >= high - middle, 2, 0)
    quats = splats.quats / np.maximum(np.linalg.norm(splats.quats, axis=1, keepdims=True), np.float32(1e-12))
    known = tuple(np.ascontiguousarray(t) for t in (splats.scales, quats, splats.opacities, order, spun))
    sums = np.zeros((num, NUM_SUMS))

    def signs(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
        for _ in range(probes):
            yield rng.signs(shape)

    def add(some: slice, *gradients: np.ndarray) -> None:
        size = len(gradients[0])
        add_squared(*gradients, *(values[some] for values in known), sums[some], 0, size)

    find = gradient_source(renderer)
    for view in range(cameras.num_views):
        if view == 0 or splats.degree:  # without harmonics all views see the same colours
            seen = splats.seen_from(to_numpy(cameras.centers[view]))
            seen = replace(seen, colors=np.minimum(seen.colors, np.float32(BRIGHTEST)))
        find(seen, cameras.select([view]), signs, add)
    scale = 1 / (probes * cameras.num_views * cameras.width * cameras.height * 3)
    return {name: sums[:, column] * scale for column, name in enumerate(_SLOPES)}
