"""The network for explicit Gaussians: what it sees of a received one, and the gains that it makes of it.

Where a share `rho` of the Gaussians around one is lost, `L = -log(1 - rho)`. A size gain of `exp(L / 2)` keeps the area
that surfaces cover, an opacity `1 - (1 - a) ** exp(L)` the light that passes through many thin layers: which of the two
a place needs depends on how its Gaussians overlap, and the network says so.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from splatwire.conceal.base import Concealed
from splatwire.conceal.scene_free.network import Perceptron
from splatwire.model import Partial, SplatScene
from splatwire.ops.arrays import lower_median
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.scene.anchors import MIN_SIZE

ELEMENT_SIGNATURE = 12
"""Entries of what the network sees."""
_NEIGHBORS, _CLOSE, _SPACING_RANK = 64, 32, 6
_MOST_LOST = 0.97
BASE = (0.15, 0.75)
"""Exponents of `exp(L)` before the network changes them, of size and of opacity."""
SIZES, POWERS = (-0.5, 1.0), (-0.5, 2.5)
"""Least and largest exponents."""
OPACITIES = (1e-4, 1 - 1e-4)


@dataclass(frozen=True, eq=False)
class ElementInputs:
    """All that the network needs of one loss of one scene.

    Attributes:
        rows: The received Gaussians.
        signature: What is known of them and their surroundings: ratios only, no unit of length.
        lost: `L` of the surroundings of each.
        opacity: Their opacities.
    """

    rows: Int64[np.ndarray, "M"]
    signature: Float[np.ndarray, "M D"]
    lost: Float[np.ndarray, "M"]
    opacity: Float[np.ndarray, "M"]


def element_inputs(partial: Partial[SplatScene]) -> ElementInputs:
    """Looks at the surroundings of every received Gaussian."""
    splats, known = partial.scene.splats, partial.known
    rows, opacities, log_axes = np.flatnonzero(known), splats.opacities, splats.log_axes
    log_sizes = log_axes.mean(axis=1)
    near, distance = nearest_others(NeighborTree(splats.means), splats.means[rows], rows, _NEIGHBORS)
    gone = (~known).astype(distance.dtype)
    size, area = np.exp(log_sizes), np.exp(2 * log_sizes)
    tiny = np.finfo(size.dtype).tiny
    lost = _gain_for((gone * size)[near].sum(axis=1) / np.maximum(size[near].sum(axis=1), tiny))
    close, far = near[:, :_CLOSE], distance[:, :_CLOSE]
    there = 1 - gone[close]
    reach = (far / np.maximum(np.sqrt(area[close] + area[rows, None]), MIN_SIZE)) ** 2
    clear = np.clip(opacities, *OPACITIES)
    logit = np.clip(np.log(clear / (1 - clear)), -6, 6)
    own, count = log_sizes[rows], np.maximum(there.sum(axis=1), 1)
    cover = there * opacities[close] * np.exp(-reach / 2)
    weight = area[close] * np.exp(-reach / 4)
    columns = [
        lost,
        _gain_for(gone[near[:, :12]].mean(axis=1) if near.shape[1] else gone[rows]),
        np.full_like(own, _gain_for(gone.mean())),
        own - _spacing(far, there, own),
        own - lower_median(log_sizes[known]),
        own - (there * log_sizes[close]).sum(axis=1) / count,
        np.minimum(log_axes[rows, 0] - log_axes[rows, 1], 6),
        np.minimum(log_axes[rows, 1] - log_axes[rows, 2], 6),
        logit[rows],
        (there * logit[close]).sum(axis=1) / count,
        np.log1p(cover.sum(axis=1)),
        _gain_for((weight * (1 - there)).sum(axis=1) / np.maximum(weight.sum(axis=1) + area[rows], tiny)),
    ]
    return ElementInputs(rows, np.stack(columns, axis=1), lost, opacities[rows])


def _gain_for(share: Any) -> Any:
    return -np.log1p(-np.minimum(share, _MOST_LOST))


def _spacing(distance: np.ndarray, there: np.ndarray, own: np.ndarray) -> Float[np.ndarray, "M"]:
    """Logarithm of the distance of a near received neighbour; the own size where there is none."""
    if distance.shape[1] < _SPACING_RANK:
        return own
    ranked = np.partition(np.where(there > 0, distance, np.inf), _SPACING_RANK - 1, axis=1)[:, _SPACING_RANK - 1]
    return np.where(np.isfinite(ranked), np.log(np.maximum(ranked, MIN_SIZE)), own)


class ElementNetwork(Perceptron):
    """A small perceptron that says how much of a loss sizes and how much opacities make up for."""

    INPUTS = ELEMENT_SIGNATURE

    def __call__(
        self, inputs: ElementInputs, trust: float | int = 1.0, base: tuple[float, float] = BASE
    ) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]:
        """Computes the gains of size and opacity, positive.

        Args:
            inputs: What is known.
            trust: How much of the network's opinion is taken, 0 for none.
            base: Exponents that it changes.
        """
        change = trust * self.evaluate(inputs.signature)
        size = np.exp(inputs.lost * np.clip(base[0] + change[:, 0], *SIZES))
        power = np.exp(inputs.lost * np.clip(base[1] + change[:, 1], *POWERS))
        opacity = np.clip(inputs.opacity, *OPACITIES)
        return size, -np.expm1(power * np.log1p(-opacity)) / opacity


def grown(
    partial: Partial, rows: Int64[np.ndarray, "M"], gains: tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]
) -> Concealed:
    """Draws what arrived with some gains, and leaves the rest out.

    Args:
        partial: What arrived.
        rows: The received elements.
        gains: Of their sizes and of their opacities.
    """
    size, opacity = np.ones_like(partial.log_sizes), np.ones_like(partial.log_sizes)
    size[rows], opacity[rows] = gains
    return Concealed(size, ~partial.known, opacity)
