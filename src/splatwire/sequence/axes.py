"""Choice of the order and signs of Gaussians' axes, so that rotations and scales change little between frames."""

import itertools

import numpy as np
from jaxtyping import Float

from splatwire.codec.gaussians.attributes import matrices_of
from splatwire.ops.quaternions import quaternions_of
from splatwire.types.splats import Splats

_ORDERS = np.array(list(itertools.permutations(range(3))))


def continue_axes(
    previous: Splats, current: Splats, partner: np.ndarray
) -> tuple[Float[np.ndarray, "M 4"], Float[np.ndarray, "M 3"]]:
    """Returns rotations and scales, with the order and signs of axes that are closest to the previous frame.

    A Gaussian has several equivalent descriptions, with different orders and signs of its axes. The choice changes the
    description, but not the Gaussian.

    Args:
        previous: Previous frame.
        current: Current frame with M Gaussians.
        partner: For each Gaussian of the current frame, index of its match in the previous frame, int64 (M); -1 for new
            Gaussians.

    Returns:
        Quaternions and scales of the current Gaussians; those of new Gaussians are unchanged.
    """
    quats, scales = current.quats.copy(), current.scales.copy()
    rows = np.flatnonzero(partner >= 0)
    if not len(rows):
        return quats, scales
    old = previous.select(partner[rows])
    was = matrices_of(old.quats.astype(np.float64))
    now = matrices_of(quats[rows].astype(np.float64))
    dots = np.einsum("nij,nik->njk", was, now)  # axis j before with axis k now
    logs_was, logs_now = np.log(old.scales), np.log(scales[rows])
    gaps = np.abs(logs_was[:, :, None] - logs_now[:, None, :])
    worth = np.abs(dots) - gaps
    axes = np.arange(3)
    totals = np.stack([worth[:, axes, order].sum(axis=1) for order in _ORDERS], axis=1)
    order = _ORDERS[totals.argmax(axis=1)]
    all_rows = np.arange(len(rows))[:, None]
    along = dots[all_rows, axes, order]
    signs = np.where(along < 0, -1.0, 1.0)
    turned = np.take_along_axis(now, order[:, None, :], axis=2) * signs[:, None, :]
    mirrored = np.linalg.det(turned) < 0
    weakest = np.abs(along).argmin(axis=1)
    turned[mirrored, :, weakest[mirrored]] *= -1
    chosen = quaternions_of(turned).astype(np.float32)
    sides = np.where((chosen * old.quats).sum(axis=1, keepdims=True) < 0, np.float32(-1), np.float32(1))
    quats[rows] = chosen * sides
    scales[rows] = np.take_along_axis(scales[rows], order, axis=1)
    return quats, scales
