"""Which rows of a scene can be drawn: the one rule, for files of other programs and for encoders alike.

What draws nothing is left out and counted, what cannot be drawn is left out with a warning; nothing else is judged by
single numbers. The rule is applied where Gaussians and anchors come in (readers, importers) and where they go out
(encoders), by these functions and no others.
"""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.scene.anchors import Anchors
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
"""Left-out rows: information about those that draw nothing, a warning about those that cannot be drawn."""
ROWS = 1 << 16
"""So many rows are looked at at a time: beside the scene itself, millions of them take little memory."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What became of each row of a scene.

    Attributes:
        kept: Rows that can be drawn.
        num_invisible: Others that draw nothing: an opacity of 0, or an anchor without a single offset.
        num_invalid: Others that cannot be drawn: a number that is not finite, a colour that a float32 does not hold, a
            negative size, a rotation of length 0.
        first_invalid: The first of those, counted from 0; None if there is none.
    """

    kept: Bool[np.ndarray, "N"]
    num_invisible: int
    num_invalid: int
    first_invalid: int | None

    __repr__ = summary_repr

    @property
    def complete(self) -> bool:
        """Whether every row is kept."""
        return not (self.num_invisible or self.num_invalid)

    def tell(self, where: object, elements: str) -> None:
        """Logs what is left out.

        Args:
            where: The file, or what is done with the scene.
            elements: What its elements are called.
        """
        total = len(self.kept)
        if self.num_invisible:
            what = f"{self.num_invisible:,} of {total:,} {elements} draw nothing and are left out"
            LOG.info("%s: %s", where, what)
        if self.num_invalid:
            what = f"{self.num_invalid:,} of {total:,} {elements} cannot be drawn and are left out"
            LOG.warning("%s: %s (the first is row %d)", where, what, self.first_invalid)


def rows_of_splats(splats: Splats) -> Rows:
    """Judges Gaussians: opacities above 0 draw something, up to 1; sizes must be above 0."""
    found = [_judged(splats.run(begin, begin + ROWS)) for begin in range(0, splats.num_gaussians, ROWS)]
    return _rows([good & drawn for good, drawn in found], [good for good, _ in found])


def _judged(some: Splats) -> tuple[np.ndarray, np.ndarray]:
    """Which Gaussians can be drawn, and which are not transparent: column by column, seven times as fast as by rows."""
    # Whatever the direction, a colour is less.
    sizes, turns = some.scales.T, some.quats.T
    with np.errstate(invalid="ignore", over="ignore"):
        colours = 2 * (np.abs(some.sh).reshape(len(some.sh), -1) @ np.ones(3 * some.sh.shape[1], np.float32))
        odd = colours - colours  # 0 of what is finite, else no number
        for values in (*some.means.T, *sizes, *turns, some.opacities):
            odd += values - values
    good = (odd == 0) & (some.opacities <= 1)
    for size in sizes:
        good &= size > 0
    return good & (sum(np.abs(turn) for turn in turns) != 0), some.opacities > 0


def rows_of_anchors(anchors: Anchors) -> Rows:
    """Judges anchors: those with an offset draw something; offsets that are masked out are not looked at."""
    drawn, valid = [], []
    for begin in range(0, anchors.num_anchors, ROWS):
        some = anchors.select(slice(begin, begin + ROWS))
        fields = (some.positions, some.features, some.scalings, some.present_offsets, some.mask)
        positions, features, scalings, offsets, mask = (to_numpy(values) for values in fields)
        good = _finite(positions, features, scalings, offsets) & (scalings >= 0).all(axis=1)
        drawn.append(good & mask.any(axis=1))
        valid.append(good | ~mask.any(axis=1))
    return _rows(drawn, valid)


def _rows(drawn: list[np.ndarray], valid: list[np.ndarray]) -> Rows:
    kept = np.concatenate(drawn) if drawn else np.zeros(0, np.bool_)
    bad = ~np.concatenate(valid) if valid else kept
    num_invalid = int(bad.sum())
    first = int(bad.argmax()) if num_invalid else None
    return Rows(kept, len(kept) - int(kept.sum()) - num_invalid, num_invalid, first)


def _finite(*columns: np.ndarray) -> np.ndarray:
    """Mask of rows whose numbers are finite in each column, bool (N)."""
    rows = len(columns[0])
    return np.logical_and.reduce([np.isfinite(values.reshape(rows, -1)).all(axis=1) for values in columns])
