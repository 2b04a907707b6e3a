"""What the network sees of a received anchor: ratios only, so that neither units nor the meaning of features matter."""

from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.conceal.scene_free.surroundings import CLOSE, Neighborhood, Surroundings
from splatwire.model import AnchorScene, Partial, Prior
from splatwire.ops.arrays import lower_median, to_arrays, to_numpy
from splatwire.scene.anchors import MIN_SIZE

SIGNATURE = 26
"""Entries of a signature."""
_COUNTS = (4, 12, 32)
_REACHES = (1.0, 4.0, 16.0)
"""Squared widths of the kernels that say how far an anchor covers, in units of the sizes of both."""
_MIDDLE_REACH = 4.0
_SPACING_RANK = 5
_MOST_LOST = 0.97


def signatures(partial: Partial[AnchorScene], around: Surroundings) -> Float[np.ndarray, "M signature"]:
    """Describes received anchors by what a receiver knows.

    The entries: losses of the whole scene, of the nearest 4, 12 and 32, of the area that neighbours of three reaches
    and of the two size classes cover; sizes against spacing and neighbours; active offsets; uncertainty of the prior.
    Shares `rho` are given as `-log(1 - rho)`, the logarithm of the area gain that would make up for them.

    Args:
        partial: What arrived.
        around: Surroundings of the anchors to describe, all of them received.
    """
    kind = around.log_size.dtype
    lost = (~partial.known).astype(kind)
    area = np.exp(2 * around.log_size)
    floor = kind.type(np.exp(around.log_size.min())) if len(lost) else kind.type(MIN_SIZE)
    sizes = np.log(np.maximum(to_numpy(partial.scene.anchors.scalings)[around.rows], floor))
    own = sizes[:, 3:].mean(axis=1)
    overall = lost.mean() if len(lost) else lost.sum()
    columns = [np.full_like(own, _gain_for(overall))]
    columns += _losses_nearby(lost, area, own, around)
    for members in around.classes:
        columns += _losses_in_class(lost, area, own, around.rows, members)
    columns += _sizes(sizes, own, around)
    columns += _shape(partial, around, own, lost)
    return np.stack(columns, axis=1).astype(kind, copy=False)


def near_losses(partial: Partial[AnchorScene], around: Surroundings) -> Float[np.ndarray, "M"]:
    """Share of what is lost among all the neighbours, weighted as in `Grow`; 0 for an anchor without any."""
    near, weight = around.near.index, around.weights
    lost = (weight * ~partial.known)[near].sum(axis=1)
    tiny = np.finfo(weight.dtype).tiny
    return (lost / np.maximum(weight[near].sum(axis=1), tiny)).astype(around.log_size.dtype)


def _gain_for(share: Any) -> Any:
    return -np.log1p(-np.minimum(share, _MOST_LOST))


def _mean(values: Float[np.ndarray, "M k"]) -> Float[np.ndarray, "M"]:
    return values.sum(axis=1) / max(values.shape[1], 1)


def _spread_of(
    area: np.ndarray, rows: np.ndarray, near: Neighborhood
) -> tuple[Float[np.ndarray, "M k"], Float[np.ndarray, "M k"]]:
    """Areas of the neighbours, and their squared distances in units of both sizes."""
    theirs = area[near.index]
    return theirs, near.distance**2 / (2 * (theirs + area[rows, None]))


def _losses_nearby(
    lost: np.ndarray, area: np.ndarray, own: np.ndarray, around: Surroundings
) -> list[Float[np.ndarray, "M"]]:
    rows, near, tiny = around.rows, around.near.first(CLOSE), np.finfo(area.dtype).tiny
    there = lost[near.index]
    columns = [_gain_for(_mean(there[:, :count])) for count in _COUNTS]
    theirs, far = _spread_of(area, rows, near)
    for reach in _REACHES:
        weight = theirs * np.exp(far / -reach)
        gone = (weight * there).sum(axis=1)
        columns.append(_gain_for(gone / np.maximum(weight.sum(axis=1) + area[rows], tiny)))
        if reach == _MIDDLE_REACH:
            columns.append(np.log1p(gone / np.exp(2 * own)))
    columns.append(_gain_for((theirs * there).sum(axis=1) / np.maximum(theirs.sum(axis=1), tiny)))
    return columns


def _losses_in_class(
    lost: np.ndarray, area: np.ndarray, own: np.ndarray, rows: np.ndarray, members: Neighborhood
) -> list[Float[np.ndarray, "M"]]:
    there = lost[members.index]
    theirs, far = _spread_of(area, rows, members)
    weight = theirs * np.exp(far / -_MIDDLE_REACH)
    gone = (weight * there).sum(axis=1)
    whole = np.maximum(weight.sum(axis=1) + area[rows], np.finfo(area.dtype).tiny)
    return [_gain_for(_mean(there)), _gain_for(gone / whole), np.log1p(gone / np.exp(2 * own))]


def _sizes(sizes: Float[np.ndarray, "M 6"], own: np.ndarray, around: Surroundings) -> list[Float[np.ndarray, "M"]]:
    distance, expected = around.near.first(CLOSE).distance, around.log_size[around.rows]
    if distance.shape[1] == 0:
        distance = np.exp(expected)[:, None]  # a lonely anchor: its own size is the only length there is
    spacing = np.log(np.maximum(distance[:, min(_SPACING_RANK, distance.shape[1] - 1)], MIN_SIZE))
    typical = lower_median(around.log_size) if len(around.log_size) else around.log_size.sum()
    return [
        own - spacing,
        sizes[:, :3].mean(axis=1) - spacing,
        sizes[:, 3:].max(axis=1) - own,
        expected - spacing,
        expected - typical,
        np.log(np.maximum(distance[:, -1], MIN_SIZE)) - spacing,
    ]


def _shape(
    partial: Partial[AnchorScene], around: Surroundings, own: np.ndarray, lost: np.ndarray
) -> list[Float[np.ndarray, "M"]]:
    """Active offsets, here and around; how far the size is from its prediction; how unsure the prior is."""
    anchors, prior, rows, near = (
        to_arrays(partial.scene.anchors),
        to_arrays(partial[Prior]),
        around.rows,
        around.near.first(CLOSE).index,
    )
    active = anchors.mask.sum(axis=1).astype(own.dtype) * (1 - lost)
    typical = active[near].sum(axis=1) / np.maximum((1 - lost)[near].sum(axis=1), 1)
    arrived = anchors.features[partial.known]
    spread = arrived.std(axis=0) if len(arrived) else np.ones(anchors.features.shape[1], own.dtype)
    scaling = prior.scaling
    unsure = scaling.scale[rows].mean(axis=1) / np.maximum(np.abs(scaling.mean[rows]).mean(axis=1), MIN_SIZE)
    return [
        np.log(np.maximum(active[rows], 0.5)),
        np.log(np.maximum(typical, 0.5)),
        own - around.log_size[rows],
        np.log(np.clip(prior.feature.scale[rows] @ (1 / np.maximum(spread, 1e-6)) / len(spread), 1e-3, 1e3)),
        np.log(np.clip(unsure, 1e-4, 1e3)),
    ]
