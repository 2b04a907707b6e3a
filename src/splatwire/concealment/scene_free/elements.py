"""Neural network of the concealer `scene_free` for explicit Gaussians: predicts factors on size and opacity.

The factors depend on the share `rho` of a Gaussian's neighbours that was lost, as `L = -log(1 - rho)`. Larger sizes
suit surfaces: the factor `exp(L / 2)` preserves the covered area. Higher opacities suit many thin layers: replacing the
opacity `a` by `1 - (1 - a) ** exp(L)` preserves their transmittance. The network chooses a combination of both factors.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from splatwire.concealment.base import Concealed
from splatwire.concealment.scene_free.network import Perceptron
from splatwire.concealment.scene_free.signature import log_gain
from splatwire.ops.arrays import lower_median
from splatwire.ops.knn import NeighborTree, nearest_others
from splatwire.types import ReceivedScene, SplatScene
from splatwire.types.anchors import MIN_SIZE

GAUSSIAN_SIGNATURE = 12
"""Number of input features per Gaussian."""
_NEIGHBORS, _CLOSE, _SPACING_RANK = 64, 32, 6
BASE = (0.15, 0.75)
"""Exponents of `exp(L)` for size and opacity before the network's correction."""
SIZES, POWERS = (-0.5, 1.0), (-0.5, 2.5)
"""Minimum and maximum exponents, of size and of opacity."""
OPACITIES = (1e-4, 1 - 1e-4)


@dataclass(frozen=True, eq=False)
class GaussianInputs:
    """Inputs of the network that predicts factors on the size and opacity of M received Gaussians.

    Attributes:
        rows: Indices in the scene of the received Gaussians.
        signature: D input features of each Gaussian, which describe it and its neighbourhood.
        lost: `-log(1 - rho)` for each Gaussian, where `rho` is the lost share of its neighbours.
        opacity: Opacities of the received Gaussians.
    """

    rows: Int64[np.ndarray, "M"]
    signature: Float[np.ndarray, "M D"]
    lost: Float[np.ndarray, "M"]
    opacity: Float[np.ndarray, "M"]


def gaussian_inputs(received: ReceivedScene[SplatScene]) -> GaussianInputs:
    """Computes the input features of every received Gaussian."""
    splats, fully_received = received.scene.splats, received.fully_received
    rows, opacities, log_axes = np.flatnonzero(fully_received), splats.opacities, splats.log_axes
    log_sizes = log_axes.mean(axis=1)
    neighbors, distance = nearest_others(NeighborTree(splats.means), splats.means[rows], rows, _NEIGHBORS)
    gone = (~fully_received).astype(distance.dtype)
    size, area = np.exp(log_sizes), np.exp(2 * log_sizes)
    tiny = np.finfo(size.dtype).tiny
    lost = log_gain((gone * size)[neighbors].sum(axis=1) / np.maximum(size[neighbors].sum(axis=1), tiny))
    close, far = neighbors[:, :_CLOSE], distance[:, :_CLOSE]
    is_received = 1 - gone[close]
    reach = (far / np.maximum(np.sqrt(area[close] + area[rows, None]), MIN_SIZE)) ** 2
    clear = np.clip(opacities, *OPACITIES)
    logit = np.clip(np.log(clear / (1 - clear)), -6, 6)
    own_sizes, count = log_sizes[rows], np.maximum(is_received.sum(axis=1), 1)
    cover = is_received * opacities[close] * np.exp(-reach / 2)
    weight = area[close] * np.exp(-reach / 4)
    columns = [
        lost,
        log_gain(gone[neighbors[:, :12]].mean(axis=1) if neighbors.shape[1] else gone[rows]),
        np.full_like(own_sizes, log_gain(gone.mean())),
        own_sizes - _spacing(far, is_received, own_sizes),
        own_sizes - lower_median(log_sizes[fully_received]),
        own_sizes - (is_received * log_sizes[close]).sum(axis=1) / count,
        np.minimum(log_axes[rows, 0] - log_axes[rows, 1], 6),
        np.minimum(log_axes[rows, 1] - log_axes[rows, 2], 6),
        logit[rows],
        (is_received * logit[close]).sum(axis=1) / count,
        np.log1p(cover.sum(axis=1)),
        log_gain((weight * (1 - is_received)).sum(axis=1) / np.maximum(weight.sum(axis=1) + area[rows], tiny)),
    ]
    return GaussianInputs(rows, np.stack(columns, axis=1), lost, opacities[rows])


def _spacing(distance: np.ndarray, received: np.ndarray, log_sizes: np.ndarray) -> Float[np.ndarray, "M"]:
    """Returns the logarithm of the distance from each Gaussian to its sixth nearest received neighbour, float (M).

    The distance measures how sparse the received Gaussians are. If fewer than six of the k neighbours were received,
    the result is the logarithm of the Gaussian's size instead.

    Args:
        distance: Distances to the nearest neighbours, world units, (M, k).
        received: 1 for received neighbours, 0 for lost ones, (M, k).
        log_sizes: Logarithms of the Gaussians' sizes, (M).
    """
    if distance.shape[1] < _SPACING_RANK:
        return log_sizes
    ranked = np.partition(np.where(received > 0, distance, np.inf), _SPACING_RANK - 1, axis=1)[:, _SPACING_RANK - 1]
    return np.where(np.isfinite(ranked), np.log(np.maximum(ranked, MIN_SIZE)), log_sizes)


class GaussianNetwork(Perceptron):
    """A small neural network that predicts factors on size and opacity of received Gaussians next to lost ones."""

    INPUTS = GAUSSIAN_SIGNATURE

    def __call__(
        self, inputs: GaussianInputs, trust: float | int = 1.0, base: tuple[float, float] = BASE
    ) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]:
        """Computes positive factors (gains) on the size and on the opacity of M received Gaussians, float (M) each.

        Args:
            inputs: Inputs of the network for M received Gaussians.
            trust: Factor on the network's correction, 0 for none.
            base: Exponents for size and for opacity before the correction; 0 for no enlargement. The network's outputs,
                times `trust`, are added to these exponents.
        """
        change = trust * self.evaluate(inputs.signature)
        size = np.exp(inputs.lost * np.clip(base[0] + change[:, 0], *SIZES))
        power = np.exp(inputs.lost * np.clip(base[1] + change[:, 1], *POWERS))
        opacity = np.clip(inputs.opacity, *OPACITIES)
        return size, -np.expm1(power * np.log1p(-opacity)) / opacity


def enlarge_received(
    received: ReceivedScene, rows: Int64[np.ndarray, "M"], gains: tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]
) -> Concealed:
    """Builds the result of a concealer from enlargement factors of received elements; lost elements are hidden.

    Args:
        received: The received scene.
        rows: Indices in the scene of the M received elements.
        gains: Factors on the size and on the opacity of the received elements.
    """
    size, opacity = np.ones_like(received.log_sizes), np.ones_like(received.log_sizes)
    size[rows], opacity[rows] = gains
    return Concealed(size, ~received.fully_received, opacity)
