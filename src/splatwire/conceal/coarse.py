"""Where fine Gaussians are lost, the coarser level that stands for them is drawn in their place."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from splatwire.conceal.base import Concealed, Concealer, check_at_least
from splatwire.conceal.registry import create_concealer, register_concealer
from splatwire.model import Partial
from splatwire.model.level_scene import Levels
from splatwire.ops.knn import NeighborTree
from splatwire.ops.quaternions import rotation_matrices
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

_COPIED, _SAME = (0.2, 0.1, 0.2, 0.1), 3.0
"""How a Gaussian and its copy differ, whose steps are coarser: apart in second sizes of the copy, logarithms of the two
larger sizes, colour, opacity; and how many times that they may."""
_CANDIDATES, _COLOUR, _ROWS = 8, 1.0, 1 << 16
"""Nearest ones that are looked at; what a difference in colour counts against a distance of one standard deviation,
where it is asked what a Gaussian was merged into; and how many are asked about at a time."""
_THINNEST = 1e-4
"""Standard deviation along an axis, relative to the largest: flat groups are known no better."""


@register_concealer("coarse", needs=(Levels,))
@dataclass(frozen=True)
class Coarse:
    """Draws what the next coarser level has of lost Gaussians; those that arrived grow a little.

    A coarser Gaussian that is a copy is drawn if its original did not arrive. One that was merged from several is drawn
    as opaque as the share that is missing of what it covers: a finer Gaussian counts for the merged one whose ellipsoid
    and colour fit it best.

    Attributes:
        exponent: Of the growth of what arrived, see `Grow`.
        trust: How opaque a merged one is at most, as a multiple of the share that is lost of the finest level.
    """

    exponent: float = 0.35
    trust: float = 3.0

    def __post_init__(self) -> None:
        check_at_least("exponent of the gain", self.exponent, 0)
        check_at_least("trust in merged Gaussians", self.trust, 0)

    @property
    def name(self) -> str:
        """`coarse`."""
        return "coarse"

    def __call__(self, partial: Partial) -> Concealed:
        """See `Concealer`."""
        levels, known = partial[Levels], partial.known
        finest = levels.of == 0
        fine, coarse = np.flatnonzero(finest & known), np.flatnonzero((levels.of == 1) & known)
        size, gain, left_out = _grown(create_concealer("grow", exponent=self.exponent), partial, finest)
        if len(coarse):
            lost = 1 - len(fine) / max(int(finest.sum()), 1)
            copied = levels.copied[coarse]
            gain[coarse] = _missing(partial.elements, fine, coarse, copied, min(1.0, self.trust * lost))
            left_out[coarse] = gain[coarse] <= 0
        return Concealed(size, left_out, gain, shows=True)


def _grown(
    grow: Concealer, partial: Partial, finest: Bool[np.ndarray, "N"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains of size and opacity that `grow` gives the finest level, and what it leaves out, as all coarser levels."""
    chosen, count = np.flatnonzero(finest), len(finest)
    erasures = Erasures(partial.erasures.received[chosen])
    own = grow(replace(partial, scene=partial.scene.select(chosen), erasures=erasures, said=()))
    size, gain, left_out = np.ones(count, np.float32), np.ones(count, np.float32), np.ones(count, np.bool_)
    size[chosen], left_out[chosen] = own.size_gain, own.left_out
    gain[chosen] = 1 if own.opacity_gain is None else own.opacity_gain
    return size, gain, left_out


def _missing(
    splats: Splats, fine: np.ndarray, coarse: np.ndarray, copied: Bool[np.ndarray, "C"], trust: float
) -> Float[np.ndarray, "C"]:
    """Share of each coarser Gaussian that is missing among those finer ones that arrived."""
    covers = _covers(splats)
    shown = np.ones(len(coarse), np.float32)
    if not len(fine):
        return shown
    original = _originals(splats, fine, coarse[copied])
    shown[np.flatnonzero(copied)[original >= 0]] = 0
    merged = np.flatnonzero(~copied)
    rest = np.ones(len(fine), np.bool_)
    rest[original[original >= 0]] = False
    if not len(merged):
        return shown
    part_of = _part_of(splats, fine[rest], coarse[merged])
    there = np.bincount(part_of, covers[fine[rest]], len(merged))
    missing = 1 - there / np.maximum(covers[coarse[merged]], 1e-300)
    shown[merged] = np.clip(missing, 0, 1) * trust
    return shown


def _part_of(splats: Splats, fine: np.ndarray, merged: np.ndarray) -> np.ndarray:
    """Which merged Gaussian each finer one was most likely merged into, an index into `merged`.

    A merged one has mean, covariance and colour of its group: distances are in its standard deviations.
    """
    centres, tree = splats.means[merged].astype(np.float64), NeighborTree(splats.means[merged])
    scales = splats.scales[merged].astype(np.float64)
    scales = np.maximum(np.maximum(scales, 1e-30), _THINNEST * scales.max(axis=1, keepdims=True))
    axes = rotation_matrices(splats.quats[merged].astype(np.float64))
    found = np.empty(len(fine), np.int64)
    for begin in range(0, len(fine), _ROWS):
        some = fine[begin : begin + _ROWS]
        near, _ = tree.query(splats.means[some], min(_CANDIDATES, len(merged)))
        apart = np.einsum("nkij,nki->nkj", axes[near], splats.means[some].astype(np.float64)[:, None] - centres[near])
        unlike = (splats.sh[some, None, 0] - splats.sh[merged[near], 0]).astype(np.float64)
        far = ((apart / scales[near]) ** 2).sum(axis=2) + _COLOUR * (unlike**2).sum(axis=2)
        found[begin : begin + len(some)] = np.take_along_axis(near, far.argmin(axis=1)[:, None], axis=1)[:, 0]
    return found


def _originals(splats: Splats, fine: np.ndarray, copies: np.ndarray) -> np.ndarray:
    """Which of the finer Gaussians each copy is of, an index into `fine`; -1 where it did not arrive."""
    near, distance = NeighborTree(splats.means[fine]).query(splats.means[copies], min(_CANDIDATES, len(fine)))
    found, size = fine[near], np.maximum(np.sort(splats.scales[copies], axis=1)[:, 1:], 1e-30)
    sizes = np.maximum(np.sort(splats.scales[found], axis=2)[..., 1:], 1e-30)
    differ = (
        distance / size[:, :1], np.abs(np.log(sizes / size[:, None])).max(axis=2),
        np.linalg.norm(splats.sh[found, 0] - splats.sh[copies, None, 0], axis=2),
        splats.opacities[found] - splats.opacities[copies, None],
    )  # fmt: skip
    unlike = np.sqrt(sum((d / step) ** 2 for d, step in zip(differ, _COPIED, strict=True)))
    best = unlike.argmin(axis=1)[:, None]
    own = np.take_along_axis(near, best, axis=1)[:, 0]
    return np.where(np.take_along_axis(unlike, best, axis=1)[:, 0] < _SAME, own, -1)


def _covers(splats: Splats) -> Float[np.ndarray, "N"]:
    """What each covers from its broad side, times its opacity; square world units."""
    ordered = np.sort(splats.scales.astype(np.float64), axis=1)
    return splats.opacities.astype(np.float64) * ordered[:, 1] * ordered[:, 2]
