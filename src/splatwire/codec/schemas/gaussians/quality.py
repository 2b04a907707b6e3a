"""How finely Gaussians are quantised."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.layout import MAX_CLASSES, STEP_BITS, STEPS
from splatwire.errors import InvalidValueError, UnknownNameError

_FLAT = (-3.5, 1.0, 0.7, 0.7, 0.66, -0.3, -1.55, -1.1, -2.1)
_SHADED = (-3.9, 1.2, -0.1, 0.9, -1.16, -2.3, -2.85, -1.0, -2.1)
"""Octaves by which the steps of `STEPS` are finer than the level says, without and with harmonics; measured on
luigi_lgm, tiger_4d and an export of snowmiku_small. Moving a centre costs more than its first order says, because
Gaussians in nearly equal depth change places."""
_SHADED_CLASSES = 4
"""Most classes with harmonics: six took 2 to 20 % more bytes at equal PSNR, 40 dB and more, on three scenes, seen from
where nobody had looked when they were chosen."""


@dataclass(frozen=True)
class Quality:
    """How finely Gaussians are quantised.

    Attributes:
        level: Octaves by which all steps are finer than at level 0; steps are powers of two.
        classes: Classes of precision, 1 to 8: the least precise has steps `2**(classes - 1)` times as large. With
            harmonics there are at most 4, and all steps are a quarter of an octave larger for each that is left out.
        position: Octaves by which places are finer than usual, for scenes of many Gaussians in nearly equal depth.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    level: float = 8.0
    classes: int = 6
    position: float = 0.0

    def __post_init__(self) -> None:
        if not -8 <= self.level <= 24 or not -16 <= self.position <= 16:
            raise InvalidValueError(
                f"a quality of level {self.level} with places {self.position} finer is not possible"
            )
        if type(self.classes) is not int or not 1 <= self.classes <= MAX_CLASSES:
            raise InvalidValueError(f"classes of precision must be 1 to {MAX_CLASSES}, not {self.classes!r}")

    def classes_of(self, degree: int) -> int:
        """Classes of precision of a scene whose harmonics have this degree."""
        return min(self.classes, _SHADED_CLASSES) if degree else self.classes

    def bases(self, degree: int) -> np.ndarray:
        """`-log2` of the steps of the least precise class, out of 2**STEP_BITS, int64, by `STEPS`."""
        classes = self.classes_of(degree)
        offsets = np.array(_SHADED if degree else _FLAT) + self.level - (self.classes - classes) / 4 - (classes - 1)
        offsets[STEPS.index("position")] += self.position
        return np.rint(offsets * (1 << STEP_BITS)).astype(np.int64)


QUALITIES = {
    "small": Quality(level=6.5),
    "default": Quality(level=8.0),
    "near-lossless": Quality(level=9.75, classes=3),
}
"""Named qualities. Few classes: a picture from where nobody looked when they were chosen is near, too."""


def quality_of(name: str | Quality) -> Quality:
    """A quality by its name, or as it is.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if isinstance(name, Quality):
        return name
    if name not in QUALITIES:
        raise UnknownNameError("quality", name, tuple(QUALITIES))
    return QUALITIES[name]
