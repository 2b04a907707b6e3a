"""Statistics of the conversion of an anchor scene to explicit Gaussians."""

from dataclasses import dataclass


@dataclass
class FitCounts:
    """Numbers of Gaussians in a conversion of an anchor scene to explicit Gaussians; updated during the conversion.

    Each existing offset of an anchor can become one Gaussian.

    Attributes:
        possible: Number of Gaussians that the anchors can have in total.
        unseen: Number of Gaussians that were left out because no view shows them.
        faint: Number of Gaussians that were left out because their mean opacity is below 1/255.
        written: Number of Gaussians in the result.
    """

    possible: int = 0
    unseen: int = 0
    faint: int = 0
    written: int = 0
