"""A scene with levels: Gaussians, and coarser ones that stand for many of them where they are far away or lost."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, UInt8

from splatwire.model.scene import RenderHints
from splatwire.model.splat_scene import SplatScene
from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class LevelScene(SplatScene):
    """All levels of a scene, ready to be encoded: the coarsest first, tile by tile.

    Attributes:
        level_sizes: Gaussians of each level, the coarsest first.
    """

    level_sizes: tuple[int, ...] = ()

    __repr__ = summary_repr

    def select(self, index: np.ndarray) -> "LevelScene":
        """See `SplatScene.select`; elements stay in their order."""
        chosen = np.zeros(self.num_elements, np.bool_)
        chosen[index] = True
        left = tuple(int(part.sum()) for part in np.split(chosen, np.cumsum(self.level_sizes)[:-1]))
        return replace(super().select(chosen), level_sizes=left)


@dataclass(frozen=True, eq=False)
class Levels:
    """Which elements of a scene stand for others.

    Attributes:
        of: Level of each, 0 for the finest, of which the scene consists.
        classes: Class of precision of each, 0 for the least.
    """

    of: UInt8[np.ndarray, "N"]
    classes: UInt8[np.ndarray, "N"]

    __repr__ = summary_repr

    @property
    def copied(self) -> Bool[np.ndarray, "N"]:
        """Which stand for themselves: a coarser level has them from a finer one, in the finer of its two classes."""
        coarser = self.of > 0
        return coarser & (self.classes == self.classes[coarser].max()) if bool(coarser.any()) else coarser

    @property
    def hints(self) -> RenderHints:
        """Draws the finest level."""
        return RenderHints(np.ones(len(self.of), np.float32), self.of > 0)
