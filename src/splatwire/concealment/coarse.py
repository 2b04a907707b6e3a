"""Concealment with levels of detail: the next coarser level replaces lost fine Gaussians."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import check_fields
from splatwire.concealment.base import Concealed, Concealer, check_at_least
from splatwire.concealment.registry import create_concealer, register_concealer
from splatwire.ops.knn import NeighborTree
from splatwire.ops.quaternions import rotation_matrices
from splatwire.types import LossMask, ReceivedScene
from splatwire.types.lod_scene import Levels
from splatwire.types.splats import Splats

_COPY_TOLERANCES = (0.2, 0.1, 0.2, 0.1)
"""Tolerances for matching a Gaussian with its coarser quantised copy: distance in units of the copy's second largest
size, logarithms of the two larger sizes, colour, opacity."""
_MAX_MISMATCH = 3.0
"""Maximum mismatch of a Gaussian and its copy, in multiples of the tolerances."""
_NUM_CANDIDATES = 8
"""Number of nearest Gaussians among which a copy or a merged Gaussian is searched."""
_COLOUR_WEIGHT = 1.0
"""Weight of a colour difference, relative to a distance of one standard deviation, when a Gaussian is assigned to a
merged Gaussian."""
_CHUNK_GAUSSIANS = 1 << 16
"""Maximum number of Gaussians that are compared at a time."""
_MIN_AXIS_RATIO = 1e-4
"""Lower bound of the standard deviations of a merged Gaussian, relative to its largest; keeps distances to flat
Gaussians finite."""


@register_concealer("coarse", needs=(Levels,))
@dataclass(frozen=True)
class Coarse:
    """Replaces lost Gaussians by Gaussians of the next coarser level of detail, and slightly enlarges received ones.

    A coarser Gaussian is a copy of one finer Gaussian, or merged from several. A copy is drawn if its original was
    lost. The opacity of a merged Gaussian is multiplied by `gap * min(1, trust * loss)`. Here, `gap` is the share of
    its area that received finer Gaussians do not cover, and `loss` is the share of lost Gaussians in the finest level.

    Attributes:
        exponent: Exponent of the factor `(1 - rho) ** -exponent` by which a received Gaussian is enlarged. Here, `rho`
            is the lost share of its nearest neighbours. 0 disables enlargement.
        trust: Value `trust` in the formula above, at least 0; 0 hides merged Gaussians.
    """

    exponent: float = 0.35
    trust: float = 3.0

    def __post_init__(self) -> None:
        check_fields(self)
        check_at_least("exponent of the gain", self.exponent, 0)
        check_at_least("trust in merged Gaussians", self.trust, 0)

    @property
    def name(self) -> str:
        """Name of this concealer in the registry, `coarse`."""
        return "coarse"

    def __call__(self, received: ReceivedScene) -> Concealed:
        """Chooses for each Gaussian of a scene with several levels of detail whether and how it is drawn.

        Args:
            received: Received scene with the Gaussians of all levels of detail.

        Returns:
            Factors on the size and the opacity of each Gaussian, and the mask of Gaussians that are not drawn. Among
            the drawn Gaussians are coarser ones in place of lost fine ones.
        """
        levels, fully_received = received[Levels], received.fully_received
        finest = levels.lod_level == 0
        fine, coarse = np.flatnonzero(finest & fully_received), np.flatnonzero((levels.lod_level == 1) & fully_received)
        size, gain, left_out = _grow_finest(create_concealer("grow", exponent=self.exponent), received, finest)
        if len(coarse):
            lost = 1 - len(fine) / max(int(finest.sum()), 1)
            copied = levels.copied[coarse]
            gain[coarse] = _coarse_opacities(received.elements, fine, coarse, copied, min(1.0, self.trust * lost))
            left_out[coarse] = gain[coarse] <= 0
        return Concealed(size, left_out, gain, draws_hidden=True)


def _grow_finest(
    grow: Concealer, received: ReceivedScene, finest: Bool[np.ndarray, "N"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Computes how much received Gaussians of the finest level of detail are enlarged, and which Gaussians are hidden.

    Args:
        grow: Concealer that enlarges received Gaussians.
        received: The received scene.
        finest: Mask of the Gaussians of the finest level of detail; all other Gaussians are hidden.

    Returns:
        Factor on the size and factor on the opacity of each Gaussian, and the mask of hidden Gaussians.
    """
    chosen, count = np.flatnonzero(finest), len(finest)
    loss_mask = LossMask(received.loss_mask.received[chosen])
    grown = grow(replace(received, scene=received.scene.select(chosen), loss_mask=loss_mask, records=()))
    size, gain, left_out = np.ones(count, np.float32), np.ones(count, np.float32), np.ones(count, np.bool_)
    size[chosen], left_out[chosen] = grown.size_gain, grown.left_out
    gain[chosen] = 1 if grown.opacity_gain is None else grown.opacity_gain
    return size, gain, left_out


def _coarse_opacities(
    splats: Splats, fine: np.ndarray, coarse: np.ndarray, copied: Bool[np.ndarray, "C"], trust: float
) -> Float[np.ndarray, "C"]:
    """Returns the opacity factors with which coarser Gaussians cover the gaps that lost finer Gaussians leave.

    Args:
        splats: Gaussians of all levels of detail.
        fine: Indices of the received Gaussians of the finest level.
        coarse: Indices of the Gaussians of the next coarser level.
        copied: Mask of the coarser Gaussians that are exact copies of a finer one, bool (C).
        trust: Additional factor on the opacities of merged Gaussians, 0 to 1. Below 1, merged Gaussians cover the gaps
            only in part.
    """
    # a copy is drawn unless its original arrived; a merged Gaussian gets the share of its area that is not covered
    coverage = _coverage(splats)
    factors = np.where(copied, 1, trust).astype(np.float32)
    if not len(fine):
        return factors
    original = _originals(splats, fine, coarse[copied])
    factors[np.flatnonzero(copied)[original >= 0]] = 0
    merged = np.flatnonzero(~copied)
    is_uncopied = np.ones(len(fine), np.bool_)
    is_uncopied[original[original >= 0]] = False
    if not len(merged):
        return factors
    merged_of = _merged_index(splats, fine[is_uncopied], coarse[merged])
    received_cover = np.bincount(merged_of, coverage[fine[is_uncopied]], len(merged))
    missing = 1 - received_cover / np.maximum(coverage[coarse[merged]], 1e-300)
    factors[merged] = np.clip(missing, 0, 1) * trust
    return factors


def _merged_index(splats: Splats, fine: np.ndarray, merged: np.ndarray) -> np.ndarray:
    """Returns for each finer Gaussian the index in `merged` of the coarser Gaussian that probably replaces it.

    Args:
        splats: Gaussians of all levels of detail.
        fine: Indices in `splats` of the finer Gaussians, int64 (n).
        merged: Indices in `splats` of the coarser Gaussians, each merged from several finer ones.
    """
    centres, tree = splats.means[merged].astype(np.float64), NeighborTree(splats.means[merged])
    scales = splats.scales[merged].astype(np.float64)
    scales = np.maximum(np.maximum(scales, 1e-30), _MIN_AXIS_RATIO * scales.max(axis=1, keepdims=True))
    axes = rotation_matrices(splats.quats[merged].astype(np.float64))
    nearest = np.empty(len(fine), np.int64)
    for begin in range(0, len(fine), _CHUNK_GAUSSIANS):
        piece = fine[begin : begin + _CHUNK_GAUSSIANS]
        neighbors, _ = tree.query(splats.means[piece], min(_NUM_CANDIDATES, len(merged)))
        offsets = np.einsum(
            "nkij,nki->nkj", axes[neighbors], splats.means[piece].astype(np.float64)[:, None] - centres[neighbors]
        )
        colour_differences = (splats.sh[piece, None, 0] - splats.sh[merged[neighbors], 0]).astype(np.float64)
        # a merged Gaussian has the mean, covariance and colour of its finer ones, so its standard deviation is the unit
        differences = ((offsets / scales[neighbors]) ** 2).sum(axis=2)
        differences += _COLOUR_WEIGHT * (colour_differences**2).sum(axis=2)
        best = differences.argmin(axis=1)[:, None]
        nearest[begin : begin + len(piece)] = np.take_along_axis(neighbors, best, axis=1)[:, 0]
    return nearest


def _originals(splats: Splats, fine: np.ndarray, copies: np.ndarray) -> np.ndarray:
    """Finds the original of each copied Gaussian: the Gaussian of the finest level of detail from which it was copied.

    Args:
        splats: Gaussians of all levels of detail.
        fine: Indices in `splats` of the received Gaussians of the finest level.
        copies: Indices in `splats` of the Gaussians of coarser levels that are copies of a single fine Gaussian, int64
            (C).

    Returns:
        Index in `fine` of the original of each copy, int64 (C); -1 if the original was not received.
    """
    # A stream does not contain this relation: the original has nearly the same position, size, colour and opacity.
    neighbors, distance = NeighborTree(splats.means[fine]).query(splats.means[copies], min(_NUM_CANDIDATES, len(fine)))
    candidates, size = fine[neighbors], np.maximum(np.sort(splats.scales[copies], axis=1)[:, 1:], 1e-30)
    sizes = np.maximum(np.sort(splats.scales[candidates], axis=2)[..., 1:], 1e-30)
    differ = (
        distance / size[:, :1], np.abs(np.log(sizes / size[:, None])).max(axis=2),
        np.linalg.norm(splats.sh[candidates, 0] - splats.sh[copies, None, 0], axis=2),
        splats.opacities[candidates] - splats.opacities[copies, None],
    )  # fmt: skip
    mismatches = np.sqrt(sum((d / step) ** 2 for d, step in zip(differ, _COPY_TOLERANCES, strict=True)))
    best = mismatches.argmin(axis=1)[:, None]
    nearest = np.take_along_axis(neighbors, best, axis=1)[:, 0]
    return np.where(np.take_along_axis(mismatches, best, axis=1)[:, 0] < _MAX_MISMATCH, nearest, -1)


def _coverage(splats: Splats) -> Float[np.ndarray, "N"]:
    """Returns a measure of the area that each Gaussian covers: product of its two largest scales and its opacity.

    The unit is square world units.
    """
    ordered = np.sort(splats.scales.astype(np.float64), axis=1)
    return splats.opacities.astype(np.float64) * ordered[:, 1] * ordered[:, 2]
