"""Conversion of an anchor scene to explicit Gaussians that look the same in many views."""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from splatwire.anchors.export.counts import FitCounts
from splatwire.anchors.export.neural import GaussiansInView, PossibleGaussians, gaussians_in_view, possible_gaussians
from splatwire.anchors.export.visibility import MIN_ALPHA, EachGradient, visible_areas
from splatwire.errors import InvalidValueError
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions, sh_functions
from splatwire.ops.threads import one_blas_thread
from splatwire.types import AnchorScene, Cameras, Scene
from splatwire.types.splats import Splats

MAX_VIEWS = 128
"""Maximum number of views. An even selection of more views is used, because each view takes two bytes per Gaussian."""
RIDGE = 3e-4
"""Ridge regularisation: the penalty on coefficients of degree l is this value times l squared.

The weights of the views sum to 1."""
_CONSTANT_RIDGE = 1e-6
_CHUNK = 2048
_MIN_SCALE = 1e-9


def fit_splats(
    scene: Scene,
    cameras: Cameras,
    each_gradient: EachGradient,
    *,
    degree: int = MAX_DEGREE,
    counts: FitCounts | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Splats]:
    """Fits explicit Gaussians to a scene, a few thousand at a time.

    The networks of the scene predict colour, opacity and shape of a Gaussian for each view. The fit averages these
    predictions over the views, weighted by the Gaussian's visible area in each view.

    Args:
        scene: The scene.
        cameras: Views of the fit, ideally the training cameras.
        each_gradient: Renderer with image gradients, such as `splatwire.render.cpu.each_gradient_cpu`.
        degree: Degree of the spherical harmonics, 0 to 3.
        counts: Numbers of written and omitted Gaussians, updated during the fit; None for no statistics.
        progress: Called with the name of the current task and its completed fraction.

    Yields:
        Gaussians in the order of anchors and offsets, without those that are invisible or almost transparent. Positions
        are relative to the origin of the scene.

    Raises:
        InvalidValueError: If the degree is not supported, or nothing is visible in any view.
    """
    assert isinstance(scene, AnchorScene)
    num_functions(degree)
    cameras = cameras.relative_to(scene.origin)
    if cameras.num_views < 1:
        raise InvalidValueError("a fit needs at least one view")
    if cameras.num_views > MAX_VIEWS:
        cameras = cameras.select([i * cameras.num_views // MAX_VIEWS for i in range(MAX_VIEWS)])
    counts = FitCounts() if counts is None else counts
    report = progress or (lambda label, share: None)
    possible = possible_gaussians(scene)
    counts.possible = possible.num_gaussians
    areas = visible_areas(scene, possible, cameras, each_gradient, lambda share: report("measuring visibility", share))
    centers = cameras.centers.astype(np.float32)
    for first in range(0, possible.num_gaussians, _CHUNK):
        last = min(first + _CHUNK, possible.num_gaussians)
        yield _fit_part(scene, possible.part(first, last), areas.part(first, last), centers, degree, counts)
        report("fitting Gaussians", last / possible.num_gaussians)


@one_blas_thread()  # small matrices
def _fit_part(
    scene: AnchorScene,
    possible: PossibleGaussians,
    areas: Float[np.ndarray, "C S"],
    centers: Float[np.ndarray, "C 3"],
    degree: int,
    counts: FitCounts,
) -> Splats:
    """Fits the parameters of a part of the Gaussians to their appearance in the views.

    Args:
        scene: The scene.
        possible: The S Gaussians to fit.
        areas: Visible area of each Gaussian in each view, square pixels.
        centers: Camera centre of each view.
        degree: Degree of the spherical harmonics, 0 to 3.
        counts: Numbers of written and omitted Gaussians; updated.

    Returns:
        The fitted Gaussians, without those that are invisible or almost transparent.
    """
    views = np.flatnonzero((areas > 0).any(axis=1))
    seen = [gaussians_in_view(scene, possible, centers[view]) for view in views]
    if not seen:
        counts.unseen += possible.num_gaussians
        return Splats.empty(0, degree)
    areas = areas[views].T
    strength = np.maximum(np.stack([view.opacities for view in seen], axis=1), 0)
    weights = areas * strength
    total = weights.sum(axis=1)
    opacities = total / np.maximum(areas.sum(axis=1), 1e-12)
    drawn, clear = total > 0, opacities > MIN_ALPHA
    kept = np.flatnonzero(drawn & clear)
    counts.unseen += int((~drawn).sum())
    counts.faint += int((drawn & ~clear).sum())
    counts.written += len(kept)
    shares = weights[kept] / total[kept, None]
    means = possible.means[kept]
    away = means[:, None] - centers[views]
    directions = away / np.maximum(np.linalg.norm(away, axis=2, keepdims=True), 1e-12)
    colors = np.stack([view.colors[kept] for view in seen], axis=1)
    quats, scales = _mean_shape(seen, kept, shares)
    return Splats(means, quats, scales, opacities[kept], fit_sh(directions, colors, shares, degree))


def fit_sh(
    directions: Float[np.ndarray, "S V 3"],
    colors: Float[np.ndarray, "S V 3"],
    view_weights: Float[np.ndarray, "S V"],
    degree: int,
) -> Float[np.ndarray, "S D 3"]:
    """Fits spherical harmonics to the colours of Gaussians in several views, by weighted least squares.

    Args:
        directions: Unit vectors from the camera to the Gaussian.
        colors: RGB seen from these directions.
        view_weights: Weights of the views; they add up to 1 for each Gaussian.
        degree: 0 to 3.

    Returns:
        Coefficients; the colour is 0.5 plus the sum of the coefficients times the harmonic functions.
    """
    x, y, z = np.moveaxis(directions.astype(np.float64), -1, 0)
    basis = np.stack(sh_functions(x, y, z, degree), axis=-1)
    weighted = (basis * view_weights[:, :, None].astype(np.float64)).swapaxes(1, 2)
    degrees = np.array([l for l in range(degree + 1) for _ in range(2 * l + 1)], np.float64)  # noqa: E741
    gram = weighted @ basis + np.diag(RIDGE * degrees**2 + _CONSTANT_RIDGE)
    return np.linalg.solve(gram, weighted @ (colors.astype(np.float64) - 0.5)).astype(np.float32)


def _mean_shape(
    seen: list[GaussiansInView], indices: np.ndarray, view_weights: Float[np.ndarray, "S V"]
) -> tuple[Float[np.ndarray, "S 4"], Float[np.ndarray, "S 3"]]:
    """Averages the shapes of Gaussians over views.

    The matrix logarithms of the covariances are averaged.

    Args:
        seen: Quaternions and scales of all Gaussians in each of V views.
        indices: Indices of the S Gaussians to average.
        view_weights: Weight of each view for each Gaussian; the weights of a Gaussian add up to 1.

    Returns:
        Quaternions and scales.
    """
    total = np.zeros((len(indices), 3, 3))
    for view, now in enumerate(seen):
        axes = rotation_matrices(now.quats[indices].astype(np.float64))
        logs = np.log(np.maximum(now.scales[indices].astype(np.float64), _MIN_SCALE))
        total += view_weights[:, view, None, None] * ((axes * logs[:, None, :]) @ axes.swapaxes(1, 2))
    logs, axes = np.linalg.eigh(total)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]  # a rotation, not a mirror
    return quaternions(axes).astype(np.float32), np.exp(logs).astype(np.float32)


def quaternions(rotations: Float[np.ndarray, "S 3 3"]) -> Float[np.ndarray, "S 4"]:
    """Converts rotation matrices to unit quaternions (w, x, y, z) with w >= 0 (Bar-Itzhack's method)."""
    r = rotations
    trace = np.trace(r, axis1=1, axis2=2)
    matrix = np.zeros((len(r), 4, 4), r.dtype)
    matrix[:, 0, 0] = trace
    matrix[:, 0, 1:] = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    matrix[:, 1:, 0] = matrix[:, 0, 1:]
    matrix[:, 1:, 1:] = r + r.swapaxes(1, 2) - trace[:, None, None] * np.eye(3, dtype=r.dtype)
    quats = np.linalg.eigh(matrix)[1][:, :, 3]
    return np.where(quats[:, :1] < 0, -quats, quats)
