"""Estimates the effect of changes of anchors on the pictures, faster and less precisely than `render_sensitivity`."""

# The first half of the views only measures the effect of removing Gaussians, which does not need the networks, and
# selects the most important anchors. The second half also measures the effect of changing the features, scalings and
# offsets of these anchors, by back-propagation through the networks.

# With few views, the sum of these effects over all selected anchors is precise, but the values of single anchors are
# not. The sum is therefore divided among the anchors in proportion to the effect of removing them (`_distribute`).

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from splatwire.anchors.compiled_heads import SpawnedGaussians, drawn_with_anchors
from splatwire.anchors.head_gradients import Spawning
from splatwire.ops.threads import one_blas_thread
from splatwire.ops.twister import Twister
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.sensitivity import GatheredGradients, Sensitivity
from splatwire.types import Anchors, AnchorScene, Cameras

_TYPICAL_FACTOR = 1 / 3
"""Factor on the errors distributed to the anchors in `_distribute`. The errors are known as sums, half of which is due
to a few anchors, so that a typical anchor has less than its share. On the bundled scene the sketch (low-quality copy)
is 0.3 dB better than with factor 1, and equally good with 1/2 and 1/8."""


@one_blas_thread()  # sums must not depend on the number of processors
def quick_sensitivity(
    scene: AnchorScene,
    cameras: Cameras,
    *,
    chosen: int,
    probes: int = 1,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Sensitivity:
    """Estimates, for each of the most important anchors, how much pictures change if the anchor is removed or changed.

    Args:
        scene: The complete scene, on the CPU; not a result of loss concealment.
        cameras: Cameras; at least two views.
        chosen: Number of anchors that count as most important. The estimate for all others is 0.
        probes: Number of back-propagations per view; more give a more precise estimate.
        seed: Random seed.
        progress: Called with the finished share of views.
    """
    a, rng, background = scene.anchors, Twister(seed), np.array(scene.background, np.float32)
    cameras = cameras.relative_to(scene.origin)
    (num, count), width, first = a.mask.shape, a.features.shape[1] + a.scalings.shape[1], cameras.num_views // 2
    removal, offsets = np.zeros(num), np.zeros((num, count))
    rows, parts = np.empty(0, np.int64), list[_NetworkErrors]()
    for view in range(cameras.num_views):
        if view == first:
            rows = np.sort(np.argsort(-removal, kind="stable")[:chosen])
        seen = drawn_with_anchors(scene, cameras, view)
        gradients = GatheredGradients(seen.gaussians)
        offset_rows = seen.anchor_index * count + seen.offset_index

        def signs(
            shape: tuple[int, ...],
            view: int = view,
            rows: np.ndarray = rows,
            seen: SpawnedGaussians = seen,
            gradients: GatheredGradients = gradients,
            offset_rows: np.ndarray = offset_rows,
        ) -> Iterator[np.ndarray]:
            for probe in range(probes):
                yield rng.signs(shape)
                each = np.bincount(offset_rows, gradients.presence, num * count).reshape(num, count)
                removal[:] += each.sum(axis=1) ** 2 / probes
                offsets[:] += each**2 / probes
                if len(rows) and not probe:
                    parts.append(
                        _estimate_errors(scene, cameras.centers[view], rows, (seen, gradients.fields), each[rows])
                    )

        each_gradient_cpu(seen.gaussians, cameras.select([view]), signs, gradients.add, background)
        if progress:
            progress((view + 1) / cameras.num_views)
    scale = 1 / (cameras.num_views * cameras.width * cameras.height * 3)
    kept = np.zeros(num, np.bool_)
    kept[rows] = True
    return _distribute(removal * kept * scale, offsets * scale, _relative_size(a), parts, width)


@dataclass(frozen=True, eq=False)
class _NetworkErrors:
    """Estimated errors of one picture if attributes of anchors change, summed over selected anchors.

    Attributes:
        metric: Matrix M for changes of features and logarithms of scalings. If these values change by the vector d in
            all selected anchors, the error is `d . M d`.
        offset: Error if one coordinate of an offset changes by 1, summed over the offsets.
        offset_share: Sum of a product over the Gaussians: the error if the Gaussian is removed, times `_relative_size`
            of its anchor. The error of a single offset is `offset` times the product for its Gaussian, divided by this
            sum.
        removal: Error if one Gaussian is removed, summed over the Gaussians.
    """

    metric: Float64[np.ndarray, "D D"]
    offset: float
    offset_share: float
    removal: float


def _estimate_errors(
    scene: AnchorScene,
    camera_center: np.ndarray,
    rows: np.ndarray,
    drawn: tuple[SpawnedGaussians, list[np.ndarray]],
    each: Float64[np.ndarray, "R K"],
) -> _NetworkErrors:
    """Estimates the squared error of one picture if attributes of the selected anchors change.

    The estimates are squared derivatives of a signed sum: the sum of all pixel values, each multiplied by a random
    sign.

    Args:
        scene: The complete scene.
        camera_center: Position of the camera.
        rows: Indices of the R selected anchors.
        drawn: Gaussians of the view; and derivatives of the signed sum with respect to their attributes.
        each: For each of the K offsets of each selected anchor, change of the signed sum if the Gaussian of this offset
            is removed.
    """
    # Gradients of the Gaussians are back-propagated through the networks that generate the Gaussians. They are the
    # gradients of the sum of all pixels, each multiplied by a random sign.
    a, (seen, gradients), count = scene.anchors, drawn, scene.anchors.mask.shape[1]
    anchors = a.select(rows)
    selected_spawning = Spawning(anchors, scene.heads, camera_center.astype(np.float32))
    row_of_slot = np.full(a.num_anchors * count, -1)
    row_of_slot[seen.anchor_index * count + seen.offset_index] = np.arange(len(seen.anchor_index))
    row_of_slot = row_of_slot[rows[selected_spawning.anchor_index] * count + selected_spawning.offset_index]
    is_drawn = row_of_slot >= 0  # False if out of view or too faint to be drawn
    upstream = [np.zeros((len(row_of_slot), *g.shape[1:]), np.float32) for g in gradients]
    for values, g in zip(upstream, gradients, strict=True):
        values[is_drawn] = g[row_of_slot[is_drawn]]
    back = selected_spawning.gradients(upstream)
    channels = np.concatenate([back.features, back.scalings * anchors.scalings], axis=1).astype(np.float64)
    share = float((each**2 * _relative_size(anchors)[:, None]).sum())
    offset = float((back.offsets.astype(np.float64) ** 2).mean(axis=2).sum())
    return _NetworkErrors(channels.T @ channels, offset, share, float((each**2).sum()))


def _relative_size(anchors: Anchors) -> Float64[np.ndarray, "N"]:
    """Returns the squared ratio of offset scale to Gaussian size for each anchor.

    The offset scale is the distance by which an offset of 1 moves a Gaussian.
    """
    # An offset that changes by 1 moves its Gaussian by the offset scale. Scale and size are means along the three
    # axes.
    scalings = np.maximum(anchors.scalings.astype(np.float64), 1e-9)
    return (scalings[:, :3].mean(axis=1) / scalings[:, 3:].mean(axis=1)) ** 2


def _distribute(
    removal: np.ndarray, offset_removal: np.ndarray, relative: np.ndarray, view_errors: list[_NetworkErrors], width: int
) -> Sensitivity:
    """Estimates the picture errors that each anchor causes, from sums over all selected anchors.

    The errors of changed attributes are known only as sums over the selected (most important) anchors. Each of these
    anchors gets a share of the sum in proportion to the picture error that its removal causes.

    Args:
        removal: Picture error if an anchor is removed, (N); 0 for anchors that are not selected.
        offset_removal: Picture error if a single Gaussian of an anchor is removed, (N, K).
        relative: Squared ratio of offset scale to Gaussian size for each anchor, from `_relative_size`, (N).
        view_errors: For each view, errors if attributes change, summed over the selected anchors.
        width: Number of feature channels and scalings per anchor, D.
    """
    # The sum is divided among the anchors in proportion to the picture error that removing each of them causes.
    metric = sum((part.metric for part in view_errors), np.zeros((width, width)))
    removed, expected = sum(part.removal for part in view_errors), sum(part.offset_share for part in view_errors)
    per_removal = _TYPICAL_FACTOR * metric.diagonal() / max(removed, 1e-30)
    per_offset = _TYPICAL_FACTOR * sum(part.offset for part in view_errors) / max(expected, 1e-30)
    return Sensitivity(
        removal=removal,
        offset_removal=offset_removal,
        channels=removal[:, None] * per_removal,
        offsets=offset_removal * relative[:, None] * per_offset,
        metric=metric * (float(removal.sum()) / max(removed, 1e-30)),
    )
