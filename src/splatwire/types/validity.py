"""Classification of Gaussians and anchors as drawable, invisible or invalid, shared by readers, importers and encoders.

Invisible elements are removed and counted. Invalid elements are removed with a warning.
"""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from splatwire.ops.arrays import to_numpy
from splatwire.ops.threads import one_blas_thread, parallel_map
from splatwire.reprs import summary_repr
from splatwire.types.anchors import Anchors
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
"""Logger of removed Gaussians and anchors: level info for invisible ones, level warning for invalid ones."""
CHUNK_ELEMENTS = 1 << 13
"""Number of elements checked at a time, whose intermediate results fit into the processor's caches."""


@dataclass(frozen=True, eq=False)
class ElementValidity:
    """Classification of the elements (Gaussians or anchors) of a scene as drawable, invisible or invalid.

    Attributes:
        kept: Mask of elements that can be drawn, bool (N).
        num_invisible: Number of elements that draw nothing: opacity 0, or an anchor without offsets.
        num_invalid: Number of elements that cannot be drawn, e.g. with a value that is not finite or a negative size.
        first_invalid: Index of the first invalid element, or None if all are valid.
    """

    kept: Bool[np.ndarray, "N"]
    num_invisible: int
    num_invalid: int
    first_invalid: int | None

    __repr__ = summary_repr

    @property
    def all_drawable(self) -> bool:
        """True if every element of the scene can be drawn."""
        return not (self.num_invisible or self.num_invalid)

    def log_removed(self, source: object, elements: str) -> None:
        """Logs how many invisible and invalid Gaussians or anchors were removed.

        Args:
            source: Name of the file or of the operation, for the message.
            elements: Name of the elements in the message, e.g. "Gaussians".
        """
        total = len(self.kept)
        if self.num_invisible:
            message = f"{self.num_invisible:,} of {total:,} {elements} draw nothing and are left out"
            LOG.info("%s: %s", source, message)
        if self.num_invalid:
            message = f"{self.num_invalid:,} of {total:,} {elements} cannot be drawn and are left out"
            LOG.warning("%s: %s (the first is row %d)", source, message, self.first_invalid)


def validity_of_splats(splats: Splats) -> ElementValidity:
    """Classifies Gaussians as drawable, invisible (opacity 0) or invalid."""
    with one_blas_thread():
        masks = parallel_map(
            lambda begin: _valid_and_visible(splats.slice_range(begin, begin + CHUNK_ELEMENTS)),
            range(0, splats.num_gaussians, CHUNK_ELEMENTS),
        )
    return _validity_of_masks([good & drawn for good, drawn in masks], [good for good, _ in masks])


def _valid_and_visible(splats: Splats) -> tuple[np.ndarray, np.ndarray]:
    """Returns the mask of Gaussians with valid values, and the mask of visible Gaussians (opacity above 0)."""
    # Each attribute column is checked separately, which is seven times as fast as checking row by row.
    sizes, turns = splats.scales.T, splats.quats.T
    with np.errstate(invalid="ignore", over="ignore"):
        colours = _largest_colours(splats)
        odd = colours - colours  # 0 if finite, else NaN
        for values in (*splats.means.T, *sizes, *turns, splats.opacities):
            odd += values - values
    good = (odd == 0) & (splats.opacities <= 1)
    for size in sizes:
        good &= size > 0
    return good & (sum(np.abs(turn) for turn in turns) != 0), splats.opacities > 0


def _largest_colours(splats: Splats) -> np.ndarray:
    """Returns an upper bound of each Gaussian's colour components in any viewing direction, (N)."""
    return 2 * (np.abs(splats.sh).reshape(len(splats.sh), -1) @ np.ones(3 * splats.sh.shape[1], np.float32))


def invalid_fields(splats: Splats) -> list[str]:
    """Returns the names of the attributes with at least one invalid value, for messages."""
    with np.errstate(invalid="ignore", over="ignore"):
        valid = {
            "positions": np.isfinite(splats.means).all(),
            "scales": (np.isfinite(splats.scales) & (splats.scales > 0)).all(),
            "rotations": (np.isfinite(splats.quats).all(axis=1) & splats.quats.any(axis=1)).all(),
            "opacities": (np.isfinite(splats.opacities) & (splats.opacities <= 1)).all(),
            "harmonics": np.isfinite(_largest_colours(splats)).all(),
        }
    return [name for name, fine in valid.items() if not fine]


def validity_of_anchors(anchors: Anchors) -> ElementValidity:
    """Classifies anchors as drawable, invisible (without offsets) or invalid."""
    drawn, valid = [], []
    for begin in range(0, anchors.num_anchors, CHUNK_ELEMENTS):
        piece = anchors.select(slice(begin, begin + CHUNK_ELEMENTS))
        fields = (piece.positions, piece.features, piece.scalings, piece.present_offsets, piece.mask)
        positions, features, scalings, offsets, mask = (to_numpy(values) for values in fields)
        good = _finite(positions, features, scalings, offsets) & (scalings >= 0).all(axis=1)
        drawn.append(good & mask.any(axis=1))
        valid.append(good | ~mask.any(axis=1))
    return _validity_of_masks(drawn, valid)


def _validity_of_masks(drawable: list[np.ndarray], not_invalid: list[np.ndarray]) -> ElementValidity:
    """Combines the masks of consecutive chunks of elements.

    Args:
        drawable: Mask of drawable elements of each chunk, bool.
        not_invalid: Mask of the elements of each chunk that do not count as invalid, bool. A transparent Gaussian with
            invalid values counts as invalid; an anchor without offsets does not.
    """
    kept = np.concatenate(drawable) if drawable else np.zeros(0, np.bool_)
    bad = ~np.concatenate(not_invalid) if not_invalid else kept
    num_invalid = int(bad.sum())
    first = int(bad.argmax()) if num_invalid else None
    return ElementValidity(kept, len(kept) - int(kept.sum()) - num_invalid, num_invalid, first)


def _finite(*columns: np.ndarray) -> np.ndarray:
    """Returns the mask of elements whose values are finite in all given arrays, bool (N)."""
    rows = len(columns[0])
    return np.logical_and.reduce([np.isfinite(values.reshape(rows, -1)).all(axis=1) for values in columns])
