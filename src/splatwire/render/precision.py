"""Class offset of each Gaussian: a number that selects the quantisation steps of all of its attributes.

A Gaussian to which images are more sensitive gets finer steps. A class offset is a precision class relative to the
finest one: 0 for the finest, negative for coarser ones.
"""

# The sensitivity to an attribute is the squared gradient of the image with respect to it. It varies by orders of
# magnitude between Gaussians, mainly with their visible area. After correction for the shape of a Gaussian, it is
# similar for all of its attributes, so one class per Gaussian suffices. The quantisation steps of consecutive classes
# differ by a factor of 2.

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64, Int8

from splatwire.anchors.appearance import explicit_gaussians, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.ops.kd_order import kd_order
from splatwire.ops.sort3 import sort3
from splatwire.ops.threads import parallel_map
from splatwire.ops.twister import Twister
from splatwire.render._precision_kernels import NUM_SUMS, add_squared
from splatwire.render.antialiasing import compensated
from splatwire.render.closeups import closeup_cameras
from splatwire.render.cpu import ViewRasterizer, each_gradient_cpu, float_arrays
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import cameras_around_splats, surrounding_cameras
from splatwire.types import Cameras, SplatScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

PART_GAUSSIANS = 1 << 18
"""Maximum number of Gaussians per spatial part of a scene; parts are measured separately, which limits memory."""
VIEWS, VIEWS_OF_PART, VIEW_SIZE = 12, 6, 224
"""Number of views around a scene and around one of its parts, and their width and height in pixels."""
MEASURED_VIEWS, MEASURED_VIEWS_OF_PART, MEASURED_CLOSEUPS = 14, 8, 36
"""Number of views of `measure_gaussians` around a scene, around one of its parts, and close to the surfaces of a scene
of one part; `VIEW_SIZE` pixels wide and high."""
MEASURED_FRAMINGS = 8
"""Number of views of `measure_gaussians` that show the whole of a scene of one part. Views around a scene may not show
the ends of a long one, such as the headstock of guitar."""
FRAMING_WEIGHT, CLOSEUP_WEIGHT = 0.3, 0.15
"""Weights of the means over the framing and the close views, relative to the weight of the views around the scene."""
_HIDDEN_CONTRAST = 0.1
"""Assumed difference of colour between a Gaussian and the surface behind it, added to the measured difference. It keeps
Gaussians that are visible but have the colour of what is behind them. Without it, kept halves of `playbot` lose 2.4 dB.
"""
FINEST_SHARE = 0.98
"""Quantile of the sensitivities that has the class offset 0; coarser classes have negative offsets."""
BRIGHTEST = 4.0
"""Upper limit of colours when gradients are computed, the maximum in views of five real files. Without it, one extreme
colour would determine the precision of all Gaussians in front of it."""
_UNSEEN = 1e-30
_SHAPE = ("scale0", "scale1", "scale2", "direction", "spin")
"""Attributes that need three different axes: the logarithms of the standard deviations s0 >= s1 >= s2, and the two
parts of the rotation."""
_MAX_AXIS_OCTAVES, _MAX_SIZE_OCTAVES = 10.0, 16.0
"""Range in which `_SLOPES` are valid: maximum ratio of consecutive axes, and maximum ratio of the median size to the
size of a Gaussian, in octaves."""
# In the order of the columns of `add_squared`.
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
"""Change of log2 of the square root of the sensitivity to an attribute per change of log2 of four properties: area,
s0 / s1, s1 / s2 and opacity. Fitted by least squares over three scenes."""
_BASES = {
    "position": -0.8, "scale0": 1.2, "scale1": 1.0, "scale2": 1.0, "direction": -1.0, "spin": -3.0, "opacity": -2.3,
    "colour": 0.0,
}  # fmt: skip
"""log2 of the square root of the sensitivity to each attribute if the logarithms of `_SLOPES` are 0, less the value for
colour."""
_WEIGHTS = {
    "position": 3.0, "scale0": 1.0, "scale1": 1.0, "scale2": 1.0, "direction": 2.0, "spin": 0.7, "opacity": 1.0
}  # fmt: skip
"""Weight of each attribute in the mean of the logarithms, about the number of its scalars. `_class_offsets` adds
that of colour: 3, or 12 with spherical harmonics."""


def scene_class_offsets(scene: Scene, cameras: Cameras | None = None, *, recompute: bool = False) -> np.ndarray | None:
    """Measures the precision class that each Gaussian needs, relative to the finest class (`measure_class_offsets`).

    A scene that was decoded already has quantisation steps, and is not measured.

    Args:
        scene: The scene.
        cameras: Cameras; None for views around the scene.
        recompute: True to ignore quantisation steps that the Gaussians already have.

    Returns:
        Class offsets, int8 (N). None for a scene without explicit Gaussians. Also None if the Gaussians already have
        quantisation steps and `recompute` is False.
    """
    splats = explicit_gaussians(scene)
    return (
        None
        if splats is None or (getattr(scene, "coding", None) is not None and not recompute)
        else measure_class_offsets(splats, None if cameras is None else cameras.relative_to(origin_of(scene)))
    )


def measure_class_offsets(
    splats: Splats, cameras: Cameras | None = None, *, probes: int = 1, seed: int = 0, part: int = PART_GAUSSIANS,
) -> np.ndarray:  # fmt: skip
    """Computes the class offset of each Gaussian from its effect on images.

    Args:
        splats: The Gaussians.
        cameras: Cameras of the images, relative to the same point as the Gaussians. None to generate cameras around the
            Gaussians.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.
        part: Maximum number of Gaussians that are measured at a time. A larger scene is divided into spatial parts of
            this size. Ignored if `cameras` is given.

    Returns:
        Precision class of each Gaussian relative to the finest class, int8 (N): 0, or negative for coarser classes. The
        quantisation steps double with each coarser class. A few values may be above 0; encoders treat them as 0.
    """
    # The sensitivity is estimated from gradients of sums of pixels with random signs (see
    # `splatwire.render.pruning`). Without cameras there are 12 views around the Gaussians or, with several parts, 6
    # around each part. At most the 2 % most sensitive Gaussians have class offsets above 0.
    class_offsets = np.empty(splats.num_gaussians, np.int8)

    def measure(members: slice | np.ndarray, splats: Splats, *, whole: bool) -> None:
        count = VIEWS if whole else VIEWS_OF_PART
        around = cameras_around_splats(splats, count, VIEW_SIZE) if cameras is None else cameras
        class_offsets[members] = _class_offsets(splats, _sensitivities(splats, around, probes, seed))

    _each_part(splats, part if cameras is None else splats.num_gaussians, measure)
    return class_offsets


@dataclass(frozen=True, eq=False)
class MeasuredGaussians:
    """Measurements of Gaussians for an encoder: class offsets, and picture errors after removal.

    Attributes:
        class_offsets: Class offset of each Gaussian, see `measure_class_offsets`.
        removal: Estimated mean squared error of the pictures if the Gaussian is removed.
    """

    # A Gaussian with nearly the colour of what is behind it is assumed to have a minimum contrast
    # (`_HIDDEN_CONTRAST`).

    class_offsets: Int8[np.ndarray, "N"]
    removal: Float64[np.ndarray, "N"]


def measure_gaussians(
    scene: SplatScene,
    cameras: Cameras | None = None,
    *,
    framing: Cameras | None = None,
    closeups: Cameras | None = None,
    seed: int = 0,
    part: int = PART_GAUSSIANS,
) -> MeasuredGaussians:
    """Measures the class offset of each Gaussian, and the image error if the Gaussian is removed.

    The class offset is the precision class relative to the finest one. It selects the quantisation steps of a Gaussian
    in an encoder.

    Args:
        scene: Gaussians that can be drawn.
        cameras: Cameras of the images in which both quantities are measured. None to generate cameras around the scene,
            cameras that show the whole scene, and cameras close to its surfaces.
        framing: Additional cameras that show the whole scene; None for none. Ignored if `cameras` is None.
        closeups: Additional cameras close to the surfaces of the scene; None for none. The image errors include these
            images, the class offsets do not depend on them. Ignored if `cameras` is None.
        seed: Random seed.
        part: Maximum number of Gaussians that are measured at a time. A larger scene is divided into spatial parts of
            this size. Ignored if `cameras` is given.
    """
    # Both results are estimated from gradients of the same rendered views.
    splats = scene.splats
    given, given_framing, given_closeups = (
        None if views is None else views.relative_to(scene.origin) for views in (cameras, framing, closeups)
    )
    measured = MeasuredGaussians(np.empty(splats.num_gaussians, np.int8), np.empty(splats.num_gaussians))

    def measure(members: slice | np.ndarray, splats: Splats, *, whole: bool) -> None:
        count = MEASURED_VIEWS if whole else MEASURED_VIEWS_OF_PART
        around, frame, close = given, given_framing, given_closeups
        if around is None:
            around = surrounding_cameras(SplatScene(splats), count, VIEW_SIZE)
        if cameras is None and whole:  # views around a part are close to its surfaces
            frame = framing_cameras(SplatScene(splats), MEASURED_FRAMINGS, VIEW_SIZE)
            close = closeup_cameras(SplatScene(splats), MEASURED_CLOSEUPS, VIEW_SIZE)
        sensitivities = _sensitivities(splats, around, 1, seed)
        if frame is not None:
            more = _sensitivities(splats, frame, 1, seed)
            sensitivities = {name: sensitivities[name] + FRAMING_WEIGHT * more[name] for name in sensitivities}
        measured.class_offsets[members] = _class_offsets(splats, sensitivities)
        measured.removal[members] = _removal(sensitivities)
        if close is not None:
            measured.removal[members] += CLOSEUP_WEIGHT * _removal(_sensitivities(splats, close, 1, seed))

    _each_part(splats, part if cameras is None else splats.num_gaussians, measure)
    return measured


def _removal(sensitivities: dict[str, Float64[np.ndarray, "G"]]) -> Float64[np.ndarray, "G"]:
    """Estimates, for each Gaussian, the mean squared error of the pictures if this Gaussian is removed.

    Args:
        sensitivities: Sensitivity of the pictures to each attribute of each Gaussian, by attribute name.
    """
    return sensitivities["opacity"] + _HIDDEN_CONTRAST**2 * sensitivities["colour"]


@dataclass(frozen=True, eq=False)
class FurtherRemoval:
    """Effect of removing each Gaussian from a pruned scene.

    Without the Gaussian, the mean squared error of the images, relative to the complete scene, grows by
    `own_error + interaction`.

    Attributes:
        own_error: Estimated mean squared change of the images.
        interaction: Interaction with the error that pruning has already caused. It is positive if both errors add up,
            such as at a hole, and negative if they cancel.
    """

    own_error: Float64[np.ndarray, "N"]
    interaction: Float64[np.ndarray, "N"]


def measure_further_removal(
    pruned: SplatScene, cameras: Cameras, references: Float[np.ndarray, "V H W 3"], *, seed: int = 0
) -> FurtherRemoval:
    """Measures, for each Gaussian of a pruned scene, how much the image error grows if this Gaussian is also removed.

    Args:
        pruned: The remaining Gaussians.
        cameras: Cameras of the images.
        references: Images of the complete scene, RGB in [0, 1].
        seed: Random seed.
    """
    # An image is an affine function of each opacity. Without a Gaussian that contributes D to the image, the squared
    # error of the difference R = pruned - complete becomes |R - D|^2 = |R|^2 + |D|^2 - 2 <R, D>. The gradient with R as
    # the gradient of the image gives <R, D>; |D|^2 is estimated with random signs (see `splatwire.render.pruning`).
    rng, splats, background = Twister(seed), pruned.splats, np.array(pruned.background, np.float32)
    cameras = cameras.relative_to(pruned.origin)
    own_error, interaction = np.zeros(splats.num_gaussians), np.zeros(splats.num_gaussians)
    for view in range(cameras.num_views):
        seen = splats.seen_from(to_numpy(cameras.centers[view]))
        seen = compensated(seen, cameras, view) if pruned.antialiased else seen
        arrays, opacities = float_arrays(seen), seen.opacities.astype(np.float64)
        rasterizer = ViewRasterizer(arrays, cameras, view, for_gradients=True)
        image, _ = rasterizer.draw(background)
        by_sign = rasterizer.gradients(arrays, image, rng.signs(image.shape))
        own_error += np.square(by_sign[3] * opacities) + _HIDDEN_CONTRAST**2 * np.square(by_sign[4]).sum(axis=1)
        difference = np.clip(image, 0, 1) - references[view]
        interaction -= 2 * rasterizer.gradients(arrays, image, difference)[3] * opacities
    scale = 1 / (cameras.num_views * cameras.width * cameras.height * 3)
    return FurtherRemoval(own_error * scale, interaction * scale)


def _each_part(splats: Splats, part: int, measure: Callable[..., None]) -> None:
    """Divides a scene into spatial parts of limited size, and calls a function for each part.

    Args:
        splats: All Gaussians.
        part: Maximum number of Gaussians per part.
        measure: The function, called as `measure(members, splats, whole=...)`. The arguments are the indices of the
            part's Gaussians, the part's Gaussians, and True if there is only one part. It is called from several
            threads.
    """
    # Several parts are processed in parallel.
    count = -(-splats.num_gaussians // part)
    if count < 2:
        measure(slice(None), splats, whole=True)
        return
    edges = np.arange(count + 1, dtype=np.int64) * splats.num_gaussians // count
    order = kd_order(splats.means, [edges])

    def measure_part(ends: tuple[int, int]) -> None:
        members = np.sort(order[slice(*ends)])
        measure(members, splats.select(members), whole=False)

    parallel_map(measure_part, list(itertools.pairwise(edges.tolist())))


def _class_offsets(splats: Splats, sensitivities: dict[str, Float64[np.ndarray, "G"]]) -> Int8[np.ndarray, "G"]:
    """Computes the class offset of each Gaussian from the sensitivity of the images to its attributes.

    Args:
        splats: The Gaussians.
        sensitivities: Sensitivity of the images to each attribute of each Gaussian, by attribute name.

    Returns:
        Precision class of each Gaussian relative to the finest class (see `measure_class_offsets`).
    """
    # The quantisation steps of the codec already depend on area, shape and opacity. A linear model therefore
    # removes the effect of these from the logarithms of the sensitivities. The class offset is the rest, averaged over
    # the attributes. Offset 0 is that of the Gaussian at the quantile `FINEST_SHARE`.
    low, middle, high = (np.log2(scales.astype(np.float64)) for scales in sort3(splats.scales))
    min_size = np.median(high) - _MAX_SIZE_OCTAVES
    size, width = np.maximum(high, min_size), np.maximum(middle, np.maximum(high, min_size) - _MAX_AXIS_OCTAVES)
    area, elongation, flatness = size + width, size - width, np.minimum(np.maximum(width - low, 0), _MAX_AXIS_OCTAVES)
    shape = np.stack([area, elongation, flatness, np.log2(np.maximum(splats.opacities.astype(np.float64), 1 / 512))])
    weights = {**_WEIGHTS, "colour": 12.0 if splats.degree else 3.0}
    # For disks, needles and points, only attributes independent of the degenerate axes are meaningful.
    is_degenerate = (high < min_size) | (middle < size - _MAX_AXIS_OCTAVES) | (low < width - _MAX_AXIS_OCTAVES)
    log_sensitivities, total = np.zeros(splats.num_gaussians), np.full(splats.num_gaussians, sum(weights.values()))
    for name, weight in weights.items():
        weighted = weight * (
            np.log2(sensitivities[name] + _UNSEEN) / 2 - _BASES[name] - np.array(_SLOPES[name]) @ shape
        )
        if name in _SHAPE:
            weighted[is_degenerate] = 0
            total[is_degenerate] -= weight
        log_sensitivities += weighted
    log_sensitivities /= total
    finest_sensitivity = np.quantile(log_sensitivities, FINEST_SHARE)
    return np.rint(log_sensitivities - finest_sensitivity).clip(-100, 100).astype(np.int8)


def _sensitivities(splats: Splats, cameras: Cameras, probes: int, seed: int) -> dict[str, Float64[np.ndarray, "G"]]:
    """Measures how strongly images react to changes of each attribute of each Gaussian.

    Args:
        splats: The Gaussians.
        cameras: Cameras of the images.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.

    Returns:
        For each attribute by name, one number per Gaussian: the mean, over all pixel values, of the squared derivative
        of a pixel value with respect to the attribute; for scales and opacity, with respect to its logarithm. It is
        also the mean over the axes of the position and of the direction, and the sum over the colour channels.
    """
    # Estimated from gradients of sums of all pixels with random signs (see `splatwire.render.pruning`).
    rng, num = Twister(seed), splats.num_gaussians
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    low, middle, high = np.log2(np.stack(sort3(splats.scales)))
    symmetry_axis = np.where(middle - low >= high - middle, 2, 0)
    quats = splats.quats / np.maximum(np.linalg.norm(splats.quats, axis=1, keepdims=True), np.float32(1e-12))
    inputs = tuple(np.ascontiguousarray(t) for t in (splats.scales, quats, splats.opacities, order, symmetry_axis))
    sums = np.zeros((num, NUM_SUMS))

    def signs(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
        for _ in range(probes):
            yield rng.signs(shape)

    def add(rows: slice, *gradients: np.ndarray) -> None:
        size = len(gradients[0])
        add_squared(*gradients, *(values[rows] for values in inputs), sums[rows], 0, size)

    for view in range(cameras.num_views):
        if view == 0 or splats.degree:  # without harmonics all views see the same colours
            seen = splats.seen_from(to_numpy(cameras.centers[view]))
            seen = replace(seen, colors=np.minimum(seen.colors, np.float32(BRIGHTEST)))
        each_gradient_cpu(seen, cameras.select([view]), signs, add)
    scale = 1 / (probes * cameras.num_views * cameras.width * cameras.height * 3)
    return {name: sums[:, column] * scale for column, name in enumerate(_SLOPES)}
