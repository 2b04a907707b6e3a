"""Statistics of the conversion of an anchor scene to explicit Gaussians."""

from dataclasses import dataclass


@dataclass
class FitCounts:
    """Numbers of Gaussians that a conversion to explicit Gaussians wrote or omitted; updated during the conversion.

    Attributes:
        possible: Number of Gaussians that the scene can have.
        unseen: Number of Gaussians omitted because they are invisible in all views.
        faint: Number of Gaussians omitted because their mean opacity is below 1/255.
        written: Number of fitted Gaussians.
    """

    possible: int = 0
    unseen: int = 0
    faint: int = 0
    written: int = 0
