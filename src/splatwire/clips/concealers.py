"""What becomes of tracks whose motion was lost: the ways that there are, by name."""

from dataclasses import dataclass

from splatwire.errors import InvalidValueError, UnknownNameError


@dataclass(frozen=True)
class ClipConcealer:
    """What becomes of tracks whose motion was lost.

    Attributes:
        name: What it is called.
        shown: Whether they are drawn at all; else they are left out until the next group.
        neighbors: They move as so many of their nearest neighbours whose motion arrived; 0 for none: they stay where
            they were.
        smooth: Whether neighbours say so by the quadratic that fits their motions best (`smooth_weights`), not by their
            mean (inverse squared distance).
        momentum: Share of their own last velocity that they go on with, where nobody tells.
        grow: Whether Gaussians whose base was never seen are made up for by those around them.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    name: str
    shown: bool = True
    neighbors: int = 0
    smooth: bool = False
    momentum: float = 0.0
    grow: bool = True

    def __post_init__(self) -> None:
        if self.neighbors < 0 or not 0 <= self.momentum <= 1:
            raise InvalidValueError(f"neighbours are 0 or more, a momentum is 0 to 1: {self}")


CLIP_CONCEALERS = {
    concealer.name: concealer
    for concealer in (
        ClipConcealer("drop", shown=False, grow=False),
        ClipConcealer("hold"),
        ClipConcealer("extrapolate", momentum=1.0),
        ClipConcealer("neighbors", neighbors=8),
        ClipConcealer("motion", neighbors=40, smooth=True),
    )
}
DEFAULT = "motion"


def clip_concealer(name: str) -> ClipConcealer:
    """A concealer of clips by its name.

    Raises:
        UnknownNameError: If there is none.
    """
    if name not in CLIP_CONCEALERS:
        raise UnknownNameError("concealer of clips", name, CLIP_CONCEALERS)
    return CLIP_CONCEALERS[name]
