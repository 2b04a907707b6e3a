"""Number of Gaussians of a fit."""

from dataclasses import dataclass


@dataclass
class FitCounts:
    """What became of a scene's Gaussians; filled while the fit runs.

    Attributes:
        possible: Gaussians that the scene can have.
        unseen: Left out because no view sees them.
        faint: Left out because their mean opacity is below 1/255.
        written: Fitted.
    """

    possible: int = 0
    unseen: int = 0
    faint: int = 0
    written: int = 0
