"""Computes the inputs of the neural network with which the concealer `scene_free` enlarges received anchors.

The inputs are shares, ratios and counts, most of them as logarithms.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.concealment.scene_free.surroundings import CLOSE, Neighborhood, Surroundings
from splatwire.ops.arrays import lower_median, to_arrays, to_numpy
from splatwire.types import AnchorScene, Prior, ReceivedScene
from splatwire.types.anchors import MIN_SIZE

SIGNATURE = 26
"""Number of network inputs per anchor."""
_COUNTS = (4, 12, 32)
_REACHES = (1.0, 4.0, 16.0)
"""Squared widths of the coverage kernels, in units of the summed sizes of both anchors."""
_MIDDLE_REACH = 4.0
_SPACING_RANK = 5
_MAX_LOST = 0.97


def signatures(received: ReceivedScene[AnchorScene], surroundings: Surroundings) -> Float[np.ndarray, "M signature"]:
    """Computes the inputs of the network of the concealer `scene_free`, one row for each received anchor.

    The inputs are:

    1. Lost shares: of the whole scene, and of the nearest 4, 12 and 32 anchors.
    2. Lost shares of the area that neighbours cover. Near neighbours have larger weights; three rates of decrease with
       distance are used. Some shares count large anchors only (`Surroundings.classes`).
    3. Sizes, relative to the distances and sizes of neighbours.
    4. Numbers of active offsets, and ratio of the size to its prediction from the hash grid. Also relative
       uncertainties of such predictions.

    Args:
        received: The received scene.
        surroundings: Neighbours and expected sizes of the received anchors.
    """
    kind = surroundings.log_size.dtype
    lost = (~received.fully_received).astype(kind)
    area = np.exp(2 * surroundings.log_size)
    floor = kind.type(np.exp(surroundings.log_size.min())) if len(lost) else kind.type(MIN_SIZE)
    sizes = np.log(np.maximum(to_numpy(received.scene.anchors.scalings)[surroundings.rows], floor))
    own_sizes = sizes[:, 3:].mean(axis=1)
    overall = lost.mean() if len(lost) else lost.sum()
    columns = [np.full_like(own_sizes, log_gain(overall))]
    columns += _losses_nearby(lost, area, own_sizes, surroundings)
    for members in surroundings.classes:
        columns += _losses_in_class(lost, area, own_sizes, surroundings.rows, members)
    columns += _sizes(sizes, own_sizes, surroundings)
    columns += _size_features(received, surroundings, own_sizes, lost)
    return np.stack(columns, axis=1).astype(kind, copy=False)


def near_losses(received: ReceivedScene[AnchorScene], surroundings: Surroundings) -> Float[np.ndarray, "M"]:
    """Returns, for each of M anchors, the share of its nearest neighbours that is lost, 0 to 1.

    The share is 0 for an anchor without neighbours.

    Args:
        received: The received scene.
        surroundings: Neighbours of the M anchors, and the weight of each neighbour in the share.
    """
    neighbors, weight = surroundings.near.index, surroundings.weights
    lost = (weight * ~received.fully_received)[neighbors].sum(axis=1)
    tiny = np.finfo(weight.dtype).tiny
    return (lost / np.maximum(weight[neighbors].sum(axis=1), tiny)).astype(surroundings.log_size.dtype)


def log_gain(share: Any) -> Any:
    """Returns the logarithm of `1 / (1 - share)`, where `share` is the lost share of neighbours.

    The factor `1 / (1 - share)` on the area of received neighbours compensates for the lost ones.
    """
    return -np.log1p(-np.minimum(share, _MAX_LOST))


def _mean(values: Float[np.ndarray, "M k"]) -> Float[np.ndarray, "M"]:
    return values.sum(axis=1) / max(values.shape[1], 1)


def _weighting_inputs(
    area: np.ndarray, rows: np.ndarray, neighbors: Neighborhood
) -> tuple[Float[np.ndarray, "M k"], Float[np.ndarray, "M k"]]:
    """Returns the area and the relative squared distance of each neighbour, which determine its weight.

    The squared distance is divided by twice the sum of the anchor's and the neighbour's area.

    Args:
        area: Area of each anchor of the scene, as predicted from the hash grid.
        rows: Indices in the scene of the M anchors.
        neighbors: Nearest neighbours of the M anchors.
    """
    theirs = area[neighbors.index]
    return theirs, neighbors.distance**2 / (2 * (theirs + area[rows, None]))


def _losses_nearby(
    lost: np.ndarray, area: np.ndarray, log_sizes: np.ndarray, surroundings: Surroundings
) -> list[Float[np.ndarray, "M"]]:
    rows, neighbors, tiny = surroundings.rows, surroundings.near.first(CLOSE), np.finfo(area.dtype).tiny
    lost_neighbors = lost[neighbors.index]
    columns = [log_gain(_mean(lost_neighbors[:, :count])) for count in _COUNTS]
    theirs, far = _weighting_inputs(area, rows, neighbors)
    for reach in _REACHES:
        weight = theirs * np.exp(far / -reach)
        gone = (weight * lost_neighbors).sum(axis=1)
        columns.append(log_gain(gone / np.maximum(weight.sum(axis=1) + area[rows], tiny)))
        if reach == _MIDDLE_REACH:
            columns.append(np.log1p(gone / np.exp(2 * log_sizes)))
    columns.append(log_gain((theirs * lost_neighbors).sum(axis=1) / np.maximum(theirs.sum(axis=1), tiny)))
    return columns


def _losses_in_class(
    lost: np.ndarray, area: np.ndarray, log_sizes: np.ndarray, rows: np.ndarray, members: Neighborhood
) -> list[Float[np.ndarray, "M"]]:
    lost_members = lost[members.index]
    theirs, far = _weighting_inputs(area, rows, members)
    weight = theirs * np.exp(far / -_MIDDLE_REACH)
    gone = (weight * lost_members).sum(axis=1)
    whole = np.maximum(weight.sum(axis=1) + area[rows], np.finfo(area.dtype).tiny)
    return [log_gain(_mean(lost_members)), log_gain(gone / whole), np.log1p(gone / np.exp(2 * log_sizes))]


def _sizes(
    sizes: Float[np.ndarray, "M 6"], log_sizes: np.ndarray, surroundings: Surroundings
) -> list[Float[np.ndarray, "M"]]:
    distance, expected = surroundings.near.first(CLOSE).distance, surroundings.log_size[surroundings.rows]
    if distance.shape[1] == 0:
        distance = np.exp(expected)[:, None]  # without neighbours the anchor's size is the only known length
    spacing = np.log(np.maximum(distance[:, min(_SPACING_RANK, distance.shape[1] - 1)], MIN_SIZE))
    typical = lower_median(surroundings.log_size) if len(surroundings.log_size) else surroundings.log_size.sum()
    return [
        log_sizes - spacing,
        sizes[:, :3].mean(axis=1) - spacing,
        sizes[:, 3:].max(axis=1) - log_sizes,
        expected - spacing,
        expected - typical,
        np.log(np.maximum(distance[:, -1], MIN_SIZE)) - spacing,
    ]


def _size_features(
    received: ReceivedScene[AnchorScene], surroundings: Surroundings, log_sizes: np.ndarray, lost: np.ndarray
) -> list[Float[np.ndarray, "M"]]:
    """Computes the network inputs of M anchors that describe their own size instead of the losses around them.

    Args:
        received: The received scene.
        surroundings: Neighbours and expected sizes of the M anchors.
        log_sizes: Logarithms of the actual sizes of the M anchors.
        lost: 1 for lost anchors of the scene, 0 for received ones.

    Returns:
        Five logarithms for each anchor: number of its existing offsets; mean of this number over its received
        neighbours; ratio of its size to the predicted size; relative uncertainty of its predicted features; and
        relative uncertainty of its predicted scalings.
    """
    anchors, prior, rows, neighbors = (
        to_arrays(received.scene.anchors),
        to_arrays(received[Prior]),
        surroundings.rows,
        surroundings.near.first(CLOSE).index,
    )
    active = anchors.mask.sum(axis=1).astype(log_sizes.dtype) * (1 - lost)
    typical = active[neighbors].sum(axis=1) / np.maximum((1 - lost)[neighbors].sum(axis=1), 1)
    arrived = anchors.features[received.fully_received]
    spread = arrived.std(axis=0) if len(arrived) else np.ones(anchors.features.shape[1], log_sizes.dtype)
    scaling = prior.scaling
    unsure = scaling.scale[rows].mean(axis=1) / np.maximum(np.abs(scaling.mean[rows]).mean(axis=1), MIN_SIZE)
    return [
        np.log(np.maximum(active[rows], 0.5)),
        np.log(np.maximum(typical, 0.5)),
        log_sizes - surroundings.log_size[rows],
        np.log(np.clip(prior.feature.scale[rows] @ (1 / np.maximum(spread, 1e-6)) / len(spread), 1e-3, 1e3)),
        np.log(np.clip(unsure, 1e-4, 1e3)),
    ]
