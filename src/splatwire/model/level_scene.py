"""A scene with levels: Gaussians, and coarser ones that stand for many of them where they are far away or lost."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

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

    def select(self, index: Tensor) -> "LevelScene":
        """See `SplatScene.select`; elements stay in their order."""
        chosen = torch.zeros(self.num_elements, dtype=torch.bool)
        chosen[index] = True
        left = tuple(int(part.sum()) for part in chosen.split(list(self.level_sizes)))
        return replace(super().select(chosen), level_sizes=left)


@dataclass(frozen=True, eq=False)
class Levels:
    """Which elements of a scene stand for others.

    Attributes:
        of: Level of each, 0 for the finest, of which the scene consists.
        classes: Class of precision of each, 0 for the least.
    """

    of: UInt8[Tensor, "N"]
    classes: UInt8[Tensor, "N"]

    __repr__ = summary_repr

    @property
    def copied(self) -> Bool[Tensor, "N"]:
        """Which stand for themselves: a coarser level has them from a finer one, in the finer of its two classes."""
        coarser = self.of > 0
        return coarser & (self.classes == self.classes[coarser].max()) if bool(coarser.any()) else coarser

    @property
    def hints(self) -> RenderHints:
        """Draws the finest level."""
        return RenderHints(torch.ones(len(self.of)), self.of > 0)
