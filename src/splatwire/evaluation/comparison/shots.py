"""Selects the pictures of a file for the report of a comparison: fixed views, and the view with the lowest PSNR."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from splatwire.evaluation.pixels import error_map, jpeg, to_pixels


@dataclass(frozen=True)
class Shot:
    """A picture of one view and its reference, as JPEG data URLs.

    Attributes:
        view: Index of the view.
        psnr: PSNR in decibels; infinite if the picture equals its reference.
        picture: The picture.
        reference: The reference picture.
        difference: Error of each pixel: the largest channel difference, amplified.
    """

    view: int
    psnr: float
    picture: str
    reference: str
    difference: str


@dataclass
class Shots:
    """Collects the pictures of a compared file that a report shows: fixed views, and the view with the lowest PSNR.

    Attributes:
        wanted: Indices of the views that are kept for all files.
        kept: Pictures of the views in `wanted`.
        worst: Picture of the view with the lowest PSNR; None before the first view.
    """

    NUM_VIEWS: ClassVar[int] = 3
    """Number of views that a report shows side by side."""

    wanted: Sequence[int] = ()
    kept: list[Shot] = field(default_factory=list)
    worst: Shot | None = None

    def add(
        self, view: int, psnr: float, image: Float[np.ndarray, "H W 3"], reference: Float[np.ndarray, "H W 3"]
    ) -> None:
        """Stores the images of a view if the report shows it.

        Args:
            view: Index of the view.
            psnr: PSNR in decibels.
            image: RGB in [0, 1].
            reference: RGB in [0, 1].
        """
        is_worst = self.worst is None or psnr < self.worst.psnr
        if not is_worst and view not in self.wanted:
            return
        shown, wanted = to_pixels(image), to_pixels(reference)
        shot = Shot(view, psnr, jpeg(shown), jpeg(wanted), jpeg(error_map(shown, wanted)))
        if view in self.wanted:
            self.kept.append(shot)
        if is_worst:
            self.worst = shot
