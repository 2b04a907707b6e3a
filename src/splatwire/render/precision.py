"""Precision class of each Gaussian: a number that selects the quantisation steps of all of its attributes.

A Gaussian to which images are more sensitive gets finer steps.
"""

# The sensitivity to an attribute is the squared gradient of the image with respect to it. It varies by orders of
# magnitude between Gaussians, mainly with their visible area. After correction for the shape of a Gaussian, it is
# similar for all of its attributes, so one class per Gaussian suffices. The quantisation steps of consecutive classes
# differ by a factor of 2.

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64, Int8

from splatwire.anchors.appearance import Scene, explicit_gaussians, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.ops.kd_order import kd_order
from splatwire.ops.sort3 import sort3
from splatwire.ops.threads import limit_threads, share
from splatwire.ops.twister import Twister
from splatwire.render._precision_kernels import NUM_SUMS, add_squared
from splatwire.render.antialiasing import compensated
from splatwire.render.closeups import closeup_cameras
from splatwire.render.cpu import Picture, float_arrays, keep_freed_memory
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import cameras_around_splats, surrounding_cameras
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats

PART = 1 << 18
"""Maximum number of Gaussians per spatial part of a scene; parts are measured separately, which limits memory."""
VIEWS, VIEWS_OF_PART, SIZE = 12, 6, 224
"""Number of views around a scene and around one of its parts, and their width and height in pixels."""
MEASURED_VIEWS, MEASURED_VIEWS_OF_PART, MEASURED_CLOSEUPS = 14, 8, 18
"""Number of views of `measure_gaussians` around a scene, around one of its parts, and close to the surfaces of a scene
of one part; `SIZE` pixels wide and high."""
MEASURED_FRAMINGS = 8
"""Number of views of `measure_gaussians` that show the whole of a scene of one part. Views around a scene may not show
the ends of a long one, such as the headstock of guitar."""
FRAMING_WEIGHT, CLOSEUP_WEIGHT = 0.3, 0.15
"""Weights of the means over the framing and the close views, relative to that over the views around the scene."""
_HIDDEN_CONTRAST = 0.1
"""Assumed difference of colour between a Gaussian and the surface behind it, added to the measured difference. It keeps
Gaussians that are visible but have the colour of what is behind them. Without it, kept halves of `playbot` lose 2.4 dB.
"""
FINEST_SHARE = 0.98
"""Quantile of the sensitivities that defines class 0; coarser classes have negative numbers."""
BRIGHTEST = 4.0
"""Upper limit of colours when gradients are computed, the maximum in views of five real files. Without it, one extreme
colour would determine the precision of all Gaussians in front of it."""
_TOGETHER = 8
"""Number of views whose results are in memory at a time."""
_UNSEEN = 1e-30
_SHAPE = ("scale0", "scale1", "scale2", "direction", "spin")
_MAX_AXIS_OCTAVES, _MAX_SIZE_OCTAVES = 10.0, 16.0
"""Range in which `_SLOPES` are valid: maximum ratio of consecutive axes, and maximum ratio of the median size to the
size of a Gaussian, in octaves."""
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
"""Change of log2 of the sensitivity to an attribute per change of log2 of four properties of the Gaussian: area,
s0 / s1, s1 / s2 and opacity. s0 >= s1 >= s2 are its standard deviations. Fitted by least squares over three scenes."""
_BASES = {
    "position": -0.8, "scale0": 1.2, "scale1": 1.0, "scale2": 1.0, "direction": -1.0, "spin": -3.0, "opacity": -2.3,
    "colour": 0.0,
}  # fmt: skip
_WEIGHTS = {
    "position": 3.0, "scale0": 1.0, "scale1": 1.0, "scale2": 1.0, "direction": 2.0, "spin": 0.7, "opacity": 1.0
}  # fmt: skip
"""Number of scalars of each attribute; colour has 3, and about 12 with spherical harmonics."""


def scene_precision_classes(
    scene: Scene, cameras: Cameras | None = None, *, recompute: bool = False
) -> np.ndarray | None:
    """Returns the precision class (set of quantisation steps) of each Gaussian.

    Args:
        scene: The scene.
        cameras: Cameras; None for views around the scene.
        recompute: True to ignore quantisation steps that the Gaussians already have.

    Returns:
        Classes, int8 (N); None if the scene already has quantisation steps.
    """
    splats = explicit_gaussians(scene)
    return (
        None
        if splats is None or (getattr(scene, "coding", None) is not None and not recompute)
        else precision_classes(splats, None if cameras is None else cameras.relative_to(origin_of(scene)))
    )


def precision_classes(
    splats: Splats, cameras: Cameras | None = None, *, probes: int = 1, seed: int = 0, part: int = PART,
) -> np.ndarray:  # fmt: skip
    """Computes the precision class (set of quantisation steps) of each Gaussian from its effect on images.

    Args:
        splats: The Gaussians.
        cameras: Cameras of the images; None for views around the Gaussians.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.
        part: Maximum number of Gaussians that are measured together, if no cameras are given.

    Returns:
        Class of each Gaussian, int8 (N). The quantisation steps of class c - 1 are twice as large as those of class c.
        Nearly all classes are 0 or negative.
    """
    # The sensitivity is estimated from gradients of sums of pixels with random signs (see
    # `splatwire.render.pruning`). Without cameras there are 12 views around the Gaussians or, with several parts, 6
    # around each part. At most the 2 % most sensitive Gaussians have classes above 0.
    classes = np.empty(splats.num_gaussians, np.int8)

    def measure(members: slice | np.ndarray, splats: Splats, *, whole: bool) -> None:
        count = VIEWS if whole else VIEWS_OF_PART
        around = cameras_around_splats(splats, count, SIZE) if cameras is None else cameras
        classes[members] = _classes(splats, _sensitivities(SplatScene(splats), around, probes, seed, removals=False)[0])

    _each_part(splats, part if cameras is None else splats.num_gaussians, measure)
    return classes


@dataclass(frozen=True, eq=False)
class MeasuredGaussians:
    """Measurements of Gaussians for an encoder: precision classes, and picture errors after removal.

    Attributes:
        classes: Precision class of each Gaussian, which selects its quantisation steps.
        removal: Mean squared error of the pictures if the Gaussian is removed.
        images: Pictures of the scene for each set of cameras, RGB in [0, 1]; empty for a scene of several parts.
    """

    # A Gaussian with nearly the colour of what is behind it is assumed to have a minimum contrast
    # (`_HIDDEN_CONTRAST`).

    classes: Int8[np.ndarray, "N"]
    removal: Float64[np.ndarray, "N"]
    images: tuple[Float[np.ndarray, "V H W 3"], ...] = ()


def measure_gaussians(
    scene: SplatScene,
    cameras: Cameras | None = None,
    *,
    framing: Cameras | None = None,
    closeups: Cameras | None = None,
    seed: int = 0,
    part: int = PART,
) -> MeasuredGaussians:
    """Measures the precision class of each Gaussian, and the image error if the Gaussian is removed.

    The precision class is a number that selects the quantisation steps of a Gaussian in an encoder.

    Args:
        scene: Gaussians that can be drawn.
        cameras: Cameras of the images; None for views around the scene, that frame it, and close to its surfaces.
        framing: Cameras that show the whole scene, given together with `cameras`; None for no further ones.
        closeups: Cameras close to the surfaces of the scene, given together with `cameras`; they only add to the errors
            after removal. None for no further ones.
        seed: Random seed.
        part: Maximum number of Gaussians that are measured together, if no cameras are given.
    """
    # Classes are estimated from gradients of the views in which removals are measured. Each view is drawn once.
    splats, images = scene.splats, list[np.ndarray]()
    measured = MeasuredGaussians(np.empty(splats.num_gaussians, np.int8), np.empty(splats.num_gaussians))

    def measure(members: slice | np.ndarray, splats: Splats, *, whole: bool) -> None:
        count = MEASURED_VIEWS if whole else MEASURED_VIEWS_OF_PART
        one = replace(scene, splats=splats, coding=None, hints=None)
        around, frame, close = cameras, framing, closeups
        if around is None:
            around = surrounding_cameras(one, count, SIZE)
        if cameras is None and whole:  # views around a part are close to its surfaces
            frame = framing_cameras(one, MEASURED_FRAMINGS, SIZE)
            close = closeup_cameras(one, MEASURED_CLOSEUPS, SIZE)
        found, removals = _sensitivities(one, around, 1, seed)
        sets = [(1.0, removals)]
        if frame is not None:
            more, removals = _sensitivities(one, frame, 1, seed)
            found = {name: found[name] + FRAMING_WEIGHT * more[name] for name in found}
            sets.append((FRAMING_WEIGHT, removals))
        if close is not None:
            sets.append((CLOSEUP_WEIGHT, _each_removal(one, close)))
        measured.classes[members] = _classes(splats, found)
        measured.removal[members] = sum(weight * each.own_error for weight, each in sets)
        if whole:
            images.extend(each.images for _, each in sets)

    _each_part(splats, part if cameras is None else splats.num_gaussians, measure)
    return replace(measured, images=tuple(images))


@dataclass(frozen=True, eq=False)
class FurtherRemoval:
    """Effect of removing each Gaussian from a scene that may be pruned already.

    Without the Gaussian, the mean squared error of the images, relative to the complete scene, grows by
    `own_error + interaction`.

    Attributes:
        own_error: Mean squared change of the images.
        interaction: Interaction with the error that pruning has already caused. It is positive if both errors add up,
            such as at a hole, and negative if they cancel.
        images: Images of the scene, RGB in [0, 1].
    """

    own_error: Float64[np.ndarray, "N"]
    interaction: Float64[np.ndarray, "N"]
    images: Float[np.ndarray, "*V H W 3"]


def measure_further_removal(
    pruned: SplatScene, cameras: Cameras, references: Float[np.ndarray, "V H W 3"]
) -> FurtherRemoval:
    """Measures, for each Gaussian of a pruned scene, how much the image error grows if this Gaussian is removed, too.

    Args:
        pruned: The remaining Gaussians.
        cameras: Cameras of the images, relative to the origin of the scene.
        references: Images of the complete scene, RGB in [0, 1].
    """
    return _each_removal(pruned, cameras, references)


@dataclass(frozen=True, eq=False)
class _View:
    """A rendered view of a scene.

    Attributes:
        arrays: Means, quaternions, scales, opacities and colours of the Gaussians in this view.
        picture: The renderer of this view.
        image: The rendering, RGB, not clamped.
    """

    arrays: list[np.ndarray]
    picture: Picture
    image: Float[np.ndarray, "H W 3"]

    @staticmethod
    def drawn(scene: SplatScene, cameras: Cameras, view: int, num_bands: int | None = None) -> "_View":
        """Renders a view of a scene.

        Args:
            scene: The scene.
            cameras: The cameras.
            view: Index of the camera.
            num_bands: Minimum number of bands of the picture; None for a number that suits several threads.
        """
        keep_freed_memory()
        seen = scene.splats.seen_from(to_numpy(cameras.centers[view]))
        seen = replace(seen, colors=np.minimum(seen.colors, np.float32(BRIGHTEST)))
        arrays = float_arrays(compensated(seen, cameras, view) if scene.antialiased else seen)
        picture = Picture(arrays, cameras, view, kept=True, num_bands=num_bands)
        return _View(arrays, picture, picture.draw(np.array(scene.background, np.float32))[0])

    def removal(self, reference: Float[np.ndarray, "H W 3"] | None) -> FurtherRemoval:
        """Measures the effect of removing each Gaussian, summed over the pixels and channels of this view.

        Args:
            reference: Picture of the complete scene; None if this scene is complete.
        """
        # An image is an affine function of each opacity. Without a Gaussian that contributes D to the image, the
        # squared error of the difference R = image - reference becomes |R - D|^2 = |R|^2 + |D|^2 - 2 <R, D>.
        shown = np.clip(self.image, 0, 1)
        difference = np.zeros_like(shown) if reference is None else shown - reference
        own_error, interaction, weights = self.picture.effects(self.image, difference).astype(np.float64).T
        return FurtherRemoval(own_error + 3 * _HIDDEN_CONTRAST**2 * weights, -2 * interaction, shown)


def _each_removal(
    scene: SplatScene, cameras: Cameras, references: Float[np.ndarray, "V H W 3"] | None = None
) -> FurtherRemoval:
    """Measures the effect of removing each Gaussian, as the mean over all views.

    Args:
        scene: The scene.
        cameras: Cameras of the images, relative to the origin of the scene.
        references: Images of the complete scene, RGB in [0, 1]; None if this scene is complete.
    """
    total = _no_removals(scene, cameras)

    def measure(view: int) -> FurtherRemoval:
        with limit_threads(1):
            return _View.drawn(scene, cameras, view, 1).removal(None if references is None else references[view])

    for first in range(0, cameras.num_views, _TOGETHER):  # limits memory
        views = range(first, min(first + _TOGETHER, cameras.num_views))
        for view, found in zip(views, share(measure, views), strict=True):
            _add_view(total, view, found)
    return total


def _no_removals(scene: SplatScene, cameras: Cameras) -> FurtherRemoval:
    """Returns zeros for the sums over all views, and space for the images."""
    images = np.empty((cameras.num_views, cameras.height, cameras.width, 3), np.float32)
    return FurtherRemoval(np.zeros(scene.num_elements), np.zeros(scene.num_elements), images)


def _add_view(total: FurtherRemoval, view: int, found: FurtherRemoval) -> None:
    """Adds the share of one view to the means over all views.

    Args:
        total: Means over all views, changed in place.
        view: Index of the view.
        found: Sums over the pixels of the view, and its image.
    """
    total.own_error[:] += found.own_error / total.images.size
    total.interaction[:] += found.interaction / total.images.size
    total.images[view] = found.images


def _each_part(splats: Splats, part: int, measure: Callable[..., None]) -> None:
    """Divides a scene into spatial parts of limited size, and calls a function for each part.

    Args:
        splats: All Gaussians.
        part: Maximum number of Gaussians per part.
        measure: The function, called as `measure(members, splats, whole=...)` with the indices of the part's Gaussians,
            the part's Gaussians, and True if there is only one part. It is called from several threads.
    """
    # Several parts are processed in parallel.
    count = -(-splats.num_gaussians // part)
    if count < 2:
        measure(slice(None), splats, whole=True)
        return
    edges = np.arange(count + 1, dtype=np.int64) * splats.num_gaussians // count
    order = kd_order(splats.means, [edges])

    def add_gradients(ends: tuple[int, int]) -> None:
        members = np.sort(order[slice(*ends)])
        measure(members, splats.select(members), whole=False)

    share(add_gradients, list(itertools.pairwise(edges.tolist())))


def _classes(splats: Splats, sensitivities: dict[str, Float64[np.ndarray, "G"]]) -> Int8[np.ndarray, "G"]:
    """Computes the precision class of each Gaussian from the sensitivity of the images to its attributes.

    Args:
        splats: The Gaussians.
        sensitivities: Sensitivity of the images to each attribute of each Gaussian, by attribute name.

    Returns:
        Class of each Gaussian. The quantisation steps of class c + 1 are half as large as those of class c.
    """
    # The quantisation steps of the codec already depend on area, shape and opacity. A linear model therefore
    # removes the effect of these from the logarithms of the sensitivities. The class is the rest, averaged over the
    # attributes. Class 0 is that of the Gaussian at the quantile `FINEST_SHARE`.
    low, middle, high = (np.log2(scales.astype(np.float64)) for scales in sort3(splats.scales))
    least = np.median(high) - _MAX_SIZE_OCTAVES
    size, width = np.maximum(high, least), np.maximum(middle, np.maximum(high, least) - _MAX_AXIS_OCTAVES)
    area, long, thin = size + width, size - width, np.minimum(np.maximum(width - low, 0), _MAX_AXIS_OCTAVES)
    shape = np.stack([area, long, thin, np.log2(np.maximum(splats.opacities.astype(np.float64), 1 / 512))])
    weights = {**_WEIGHTS, "colour": 12.0 if splats.degree else 3.0}
    # For disks, needles and points, only attributes independent of the degenerate axes are meaningful.
    odd = (high < least) | (middle < size - _MAX_AXIS_OCTAVES) | (low < width - _MAX_AXIS_OCTAVES)
    octaves, total = np.zeros(splats.num_gaussians), np.full(splats.num_gaussians, sum(weights.values()))
    for name, weight in weights.items():
        own = weight * (np.log2(sensitivities[name] + _UNSEEN) / 2 - _BASES[name] - np.array(_SLOPES[name]) @ shape)
        if name in _SHAPE:
            own[odd] = 0
            total[odd] -= weight
        octaves += own
    octaves /= total
    finest = np.quantile(octaves, FINEST_SHARE)
    return np.rint(octaves - finest).clip(-100, 100).astype(np.int8)


def _sensitivities(
    scene: SplatScene, cameras: Cameras, probes: int, seed: int, *, removals: bool = True
) -> tuple[dict[str, Float64[np.ndarray, "G"]], FurtherRemoval]:
    """Measures how strongly images react to changes of each attribute of each Gaussian, and to their removal.

    Args:
        scene: The Gaussians.
        cameras: Cameras of the images.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.
        removals: False to leave out the effect of removals, which is then 0.

    Returns:
        Mean squares of the derivatives of all pixel values with respect to each attribute, by its name; and the effect
        of removing each Gaussian.
    """
    # Estimated from gradients of sums of all pixels with random signs (see `splatwire.render.pruning`).
    splats = scene.splats
    rng, num = Twister(seed), splats.num_gaussians
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    low, middle, high = np.log2(np.stack(sort3(splats.scales)))
    spun = np.where(middle - low >= high - middle, 2, 0)
    quats = splats.quats / np.maximum(np.linalg.norm(splats.quats, axis=1, keepdims=True), np.float32(1e-12))
    known = tuple(np.ascontiguousarray(t) for t in (splats.scales, quats, splats.opacities, order, spun))
    sums, total = np.zeros((num, NUM_SUMS)), _no_removals(scene, cameras)

    def add(rows: slice, *gradients: np.ndarray) -> None:
        size = len(gradients[0])
        add_squared(*gradients, *(values[rows] for values in known), sums[rows], 0, size)

    for view in range(cameras.num_views):
        drawn = _View.drawn(scene, cameras, view)
        for _ in range(probes):
            drawn.picture.each_gradient(drawn.arrays, drawn.image, rng.signs(drawn.image.shape), add)
        if removals:
            _add_view(total, view, drawn.removal(None))
    scale = 1 / (probes * cameras.num_views * cameras.width * cameras.height * 3)
    return {name: sums[:, column] * scale for column, name in enumerate(_SLOPES)}, total
