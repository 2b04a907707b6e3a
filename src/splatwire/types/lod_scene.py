"""Scenes with levels of detail, from coarse to fine Gaussians."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from splatwire.reprs import summary_repr
from splatwire.types.scene import RenderHints
from splatwire.types.shapes import indices_of
from splatwire.types.splat_scene import SplatScene


@dataclass(frozen=True, eq=False)
class LevelScene(SplatScene):
    """Gaussians of all levels of detail of a scene, in the order of the decoded scene.

    The coarsest level comes first. The Gaussians of a level are sorted by tile. A tile is a spatial block of
    neighbouring Gaussians of one level.

    Attributes:
        level_sizes: Number of Gaussians per level, coarsest first.
    """

    level_sizes: tuple[int, ...] = ()

    __repr__ = summary_repr

    def select(self, index: Any) -> "LevelScene":
        """Returns the scene with only the Gaussians at `index` (integers, mask or slice).

        The Gaussians keep their order, whatever the order of the integers.
        """
        chosen = np.zeros(self.num_elements, np.bool_)
        chosen[indices_of(index, self.num_elements)] = True
        sizes = tuple(int(part.sum()) for part in np.split(chosen, np.cumsum(self.level_sizes)[:-1]))
        return replace(super().select(chosen), level_sizes=sizes)


@dataclass(frozen=True, eq=False)
class Levels:
    """Level of detail and precision of each Gaussian of a scene with levels of detail.

    Attributes:
        lod_level: Level of detail to which each Gaussian belongs; 0 is the finest level, the scene itself.
        classes: Precision class of each Gaussian (its set of quantisation steps); 0 is the coarsest.
    """

    lod_level: UInt8[np.ndarray, "N"]
    classes: UInt8[np.ndarray, "N"]

    __repr__ = summary_repr

    @property
    def copied(self) -> Bool[np.ndarray, "N"]:
        """Mask of the Gaussians that are unchanged copies of a Gaussian of the next finer level of detail.

        The mask is False for all Gaussians of the finest level, and for Gaussians that were merged from several ones.
        """
        # The encoder gives copies a more precise class than merged Gaussians.
        coarser = self.lod_level > 0
        return coarser & (self.classes == self.classes[coarser].max()) if bool(coarser.any()) else coarser

    @property
    def hints(self) -> RenderHints:
        """Rendering hints that draw only the finest level of detail."""
        return RenderHints(np.ones(len(self.lod_level), np.float32), self.lod_level > 0)
