"""Explicit Gaussians that look like a neural scene: each is fitted alone, to what the heads say in many views."""

from collections.abc import Callable, Iterator
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.errors import InvalidValueError
from splatwire.exporters.counts import FitCounts
from splatwire.exporters.neural import Slots, SlotView, slot_view, slots_of
from splatwire.exporters.visibility import MIN_ALPHA, Draw, visible_areas
from splatwire.model import AnchorScene, Scene
from splatwire.model.tensors import to_tensors
from splatwire.ops.arrays import to_numpy
from splatwire.ops.quaternions import rotation_rows
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions, sh_functions
from splatwire.scene import Cameras
from splatwire.scene.origin import NO_ORIGIN
from splatwire.scene.splats import Splats

MAX_VIEWS = 128
"""More views than this are thinned out evenly: two bytes are kept per view and Gaussian."""
RIDGE = 3e-4
"""Pull of a coefficient of degree l towards 0: this times l squared, relative to the weight of all views together."""
_CONSTANT_RIDGE = 1e-6
_CHUNK = 2048
_SMALLEST_SCALE = 1e-9


def fit_splats(
    scene: Scene,
    cameras: Cameras,
    draw: Draw,
    *,
    degree: int = MAX_DEGREE,
    counts: FitCounts | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Splats]:
    """Fits explicit Gaussians to a scene, a few thousand at a time.

    A Gaussian's centre is the same in all views; colour, opacity and shape are what the heads make of the viewing
    direction and distance. The weight of a view is the area that reaches the eye there (`visible_areas`).
    Opacity is the mean over the views, 0 where it is not drawn. Shape is the mean of the logarithms of the covariances
    and colour the least-squares fit of spherical harmonics, both weighted with opacity times area.

    Args:
        scene: The scene.
        cameras: Views to fit to; best the training cameras.
        draw: A differentiable renderer.
        degree: Of the spherical harmonics, 0 to 3.
        counts: Is filled, if given.
        progress: Called with what is being done and its share.

    Yields:
        Gaussians in the order of anchors and offsets; those that no view sees, or hardly, are left out.

    Raises:
        InvalidValueError: If the degree is not supported, or no view sees anything.
    """
    assert isinstance(scene, AnchorScene)
    scene = cast(AnchorScene, to_tensors(scene))
    num_functions(degree)
    cameras = cameras.relative_to(NO_ORIGIN)
    if cameras.num_views < 1:
        raise InvalidValueError("a fit needs at least one view")
    if cameras.num_views > MAX_VIEWS:
        cameras = cameras.select([i * cameras.num_views // MAX_VIEWS for i in range(MAX_VIEWS)])
    counts = FitCounts() if counts is None else counts
    report = progress or (lambda what, share: None)
    slots = slots_of(scene)
    counts.possible = slots.num_slots
    areas = visible_areas(scene, slots, cameras, draw, lambda share: report("measuring visibility", share))
    centers = torch.as_tensor(cameras.centers).to(slots.means)
    for first in range(0, slots.num_slots, _CHUNK):
        last = min(first + _CHUNK, slots.num_slots)
        yield _fit_part(scene, slots.part(first, last), areas[:, first:last].float(), centers, degree, counts)
        report("fitting Gaussians", last / slots.num_slots)


def _fit_part(
    scene: AnchorScene,
    slots: Slots,
    areas: Float[Tensor, "C S"],
    centers: Float[Tensor, "C 3"],
    degree: int,
    counts: FitCounts,
) -> Splats:
    """Fits some Gaussians; views that see none of them are not looked at."""
    views = (areas > 0).any(dim=1).nonzero()[:, 0]
    seen = [slot_view(scene, slots, centers[view]) for view in views.tolist()]
    if not seen:
        counts.unseen += slots.num_slots
        return Splats.empty(0, degree)
    areas = areas[views].T
    strength = torch.stack([view.opacities for view in seen], dim=1).clamp(min=0)
    weights = areas * strength
    total = weights.sum(dim=1)
    opacities = total / areas.sum(dim=1).clamp(min=1e-12)
    drawn, clear = total > 0, opacities > MIN_ALPHA
    kept = (drawn & clear).nonzero()[:, 0]
    counts.unseen += int((~drawn).sum())
    counts.faint += int((drawn & ~clear).sum())
    counts.written += len(kept)
    shares = weights[kept] / total[kept, None]
    means = slots.means[kept]
    directions = torch.nn.functional.normalize(means[:, None] - centers[views], dim=2)
    colors = torch.stack([view.colors[kept] for view in seen], dim=1)
    quats, scales = _mean_shape(seen, kept, shares)
    columns = (means, quats, scales, opacities[kept], fit_sh(directions, colors, shares, degree))
    return Splats(*(to_numpy(column) for column in columns))


def fit_sh(
    directions: Float[Tensor, "S V 3"], colors: Float[Tensor, "S V 3"], shares: Float[Tensor, "S V"], degree: int
) -> Float[Tensor, "S D 3"]:
    """Fits spherical harmonics to colours by weighted least squares with a ridge that grows with the degree.

    Args:
        directions: Unit vectors from the camera to the Gaussian.
        colors: RGB seen from there.
        shares: Weights, which sum to 1 over the views.
        degree: 0 to 3.

    Returns:
        Coefficients whose sum plus 0.5 is the colour.
    """
    x, y, z = directions.double().unbind(dim=-1)
    basis = torch.stack(sh_functions(x, y, z, degree), dim=-1)
    weighted = (basis * shares[:, :, None].double()).transpose(1, 2)
    degrees = torch.tensor([l for l in range(degree + 1) for _ in range(2 * l + 1)], dtype=torch.float64)  # noqa: E741
    gram = weighted @ basis + torch.diag(RIDGE * degrees.square() + _CONSTANT_RIDGE)
    return torch.cholesky_solve(weighted @ (colors.double() - 0.5), torch.linalg.cholesky(gram)).float()


def _mean_shape(
    seen: list[SlotView], kept: Tensor, shares: Float[Tensor, "S V"]
) -> tuple[Float[Tensor, "S 4"], Float[Tensor, "S 3"]]:
    """Mean over the views in the logarithm of the covariance: one view in which a Gaussian is huge does not rule.

    Returns:
        Quaternions and scales.
    """
    total = torch.zeros(len(kept), 3, 3, dtype=torch.float64)
    for view, now in enumerate(seen):
        rows = rotation_rows(*now.quats[kept].double().unbind(dim=1))
        axes = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        logs = now.scales[kept].double().clamp(min=_SMALLEST_SCALE).log()
        total += shares[:, view, None, None] * ((axes * logs[:, None, :]) @ axes.transpose(1, 2))
    logs, axes = torch.linalg.eigh(total)
    axes[:, :, 0] *= torch.linalg.det(axes).sign()[:, None]  # a rotation, not a mirror
    return quaternions(axes).float(), logs.exp().float()


def quaternions(rotations: Float[Tensor, "S 3 3"]) -> Float[Tensor, "S 4"]:
    """Turns rotation matrices into unit quaternions (w, x, y, z) with w >= 0.

    The quaternion is the eigenvector of Bar-Itzhack's symmetric 4 x 4 matrix with the largest eigenvalue.
    """
    r = rotations
    trace = r.diagonal(dim1=1, dim2=2).sum(dim=1)
    matrix = r.new_zeros(len(r), 4, 4)
    matrix[:, 0, 0] = trace
    matrix[:, 0, 1:] = torch.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], dim=1)
    matrix[:, 1:, 0] = matrix[:, 0, 1:]
    matrix[:, 1:, 1:] = r + r.transpose(1, 2) - trace[:, None, None] * torch.eye(3, dtype=r.dtype)
    quats = torch.linalg.eigh(matrix)[1][:, :, 3]
    return torch.where(quats[:, :1] < 0, -quats, quats)
