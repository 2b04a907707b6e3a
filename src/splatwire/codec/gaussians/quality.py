"""Quality settings of explicit Gaussians, which determine the quantisation steps."""

from dataclasses import dataclass

import numpy as np

from splatwire.arguments import check_fields
from splatwire.codec.gaussians.layout import MAX_CLASSES, STEP_BITS, STEPS
from splatwire.errors import InvalidValueError, UnknownNameError, shown

_DEGREE_0_PRECISION = (-3.5, 1.0, 0.7, 0.7, 0.66, -0.3, -1.55, -1.1, -2.1)
_HIGHER_DEGREE_PRECISION = (-3.9, 1.2, -0.1, 0.9, -1.16, -2.3, -2.85, -1.0, -2.1)
"""Octaves by which the quantisation step of each quantity in `STEPS` is finer than the level: for scenes without
(`_DEGREE_0_PRECISION`) and with (`_HIGHER_DEGREE_PRECISION`) harmonics above degree 0. The values were measured on
luigi_lgm, tiger_4d and an export of snowmiku_small. Position errors cost more than a first-order estimate, because
Gaussians of nearly equal depth change their drawing order.
"""
_MAX_HIGHER_DEGREE_CLASSES = 4
"""Maximum number of precision classes for scenes with harmonics above degree 0. Six classes took 2 to 20 % more bytes
at equal PSNR (40 dB and more) on three scenes, for views that were not used to choose the classes.
"""


@dataclass(frozen=True)
class Quality:
    """Quality setting of explicit Gaussians, from which their quantisation steps are derived.

    Attributes:
        level: Precision of the finest class, -8 to 24: all quantisation steps are `2**-level` times as large as at
            level 0.
        classes: Number of precision classes, 1 to 8; an encoder assigns each Gaussian one of them. The quantisation
            steps of a class are twice as large as those of the next higher class.
        position: Additional precision of positions, -16 to 16, for scenes with many Gaussians at nearly equal depth.
            The quantisation steps of positions are `2**-position` times as large as with 0.
        precision: Additional precision of each quantity in `layout.STEPS`, octaves, -16 to 16 each.

    Raises:
        InvalidValueError: If an attribute is out of range.
    """

    level: float = 8.0
    classes: int = 6
    position: float = 0.0
    precision: tuple[float, ...] = (0.0,) * len(STEPS)

    def __post_init__(self) -> None:
        check_fields(self)
        if not -8 <= self.level <= 24 or not -16 <= self.position <= 16:
            raise InvalidValueError(
                f"Quality: level is -8 to 24 and position -16 to 16, not {self.level:g} and {self.position:g}; "
                "a quality from 0 to 100 is given as a number, such as quality=60"
            )
        if len(self.precision) != len(STEPS) or not all(-16 <= octaves <= 16 for octaves in self.precision):
            raise InvalidValueError(f"a precision has {len(STEPS)} numbers from -16 to 16, not {self.precision}")
        if type(self.classes) is not int or not 1 <= self.classes <= MAX_CLASSES:
            raise InvalidValueError(f"classes of precision must be 1 to {MAX_CLASSES}, not {self.classes!r}")

    def num_classes(self, degree: int) -> int:
        """Returns the number of precision classes for a scene.

        It is the attribute `classes`, but at most 4 for scenes with spherical harmonics above degree 0.

        Args:
            degree: Degree of the scene's spherical harmonics.
        """
        return min(self.classes, _MAX_HIGHER_DEGREE_CLASSES) if degree else self.classes

    def base_exponents(self, degree: int) -> np.ndarray:
        """Returns the quantisation steps of all attributes in precision class 0 (the coarsest).

        Args:
            degree: Degree of the scene's spherical harmonics.

        Returns:
            `-log2` of the step of each quantity in `layout.STEPS`, int64 (9), in fixed point with `STEP_BITS`
            fractional bits.
        """
        num_classes = self.num_classes(degree)
        exponents = np.array(_HIGHER_DEGREE_PRECISION if degree else _DEGREE_0_PRECISION) + self.level
        # Class 0 is `num_classes - 1` octaves coarser than the finest class. For each class fewer than asked for, all
        # steps are a quarter of an octave coarser.
        exponents = exponents - (self.classes - num_classes) / 4 - (num_classes - 1)
        exponents[STEPS.index("position")] += self.position
        exponents += self.precision
        return np.rint(exponents * (1 << STEP_BITS)).astype(np.int64)


QUALITIES = {
    "small": Quality(level=6.5),
    "default": Quality(level=8.0),
    "near-lossless": Quality(level=9.75, classes=3),
}
"""Named quality settings. `near-lossless` has few precision classes, because views from cameras that were not used to
choose the classes must be precise, too.
"""


QUALITY_NUMBERS = {"small": 40.0, "default": 60.0, "near-lossless": 85.0}
"""Quality number of each named setting."""
_FINE_CLASSES_FROM = 80.0
"""Quality number from which there are 3 precision classes instead of 6."""
_LEVELS = ((0.0, 2.5), (40.0, 6.5), (60.0, 8.0), (_FINE_CLASSES_FROM, 10.0))
_FINE_LEVELS = ((_FINE_CLASSES_FROM, 9.5), (85.0, 9.75), (100.0, 12.75))
"""Pairs of quality number and level. Levels between them are interpolated. `_LEVELS` is for numbers below
`_FINE_CLASSES_FROM`, `_FINE_LEVELS` for all others.
"""


def numbered_quality(number: int | float) -> Quality:
    """Returns the quality setting of a number from 0 (smallest) to 100 (finest).

    The numbers 40, 60 and 85 give the settings `small`, `default` and `near-lossless`.

    Raises:
        InvalidValueError: If the number is out of range.
    """
    if not 0 <= number <= 100:
        raise InvalidValueError(f"quality: a number is 0 to 100, not {shown(number)}")
    fine = number >= _FINE_CLASSES_FROM
    numbers, levels = zip(*(_FINE_LEVELS if fine else _LEVELS), strict=True)
    return Quality(float(np.interp(number, numbers, levels)), 3 if fine else 6)


def quality_of(name: str | int | float | Quality) -> Quality:
    """Returns the quality setting with a given name or number; a `Quality` is returned unchanged.

    Raises:
        UnknownNameError: If no quality has this name.
        InvalidValueError: If the number is out of range.
    """
    if isinstance(name, Quality):
        return name
    if isinstance(name, int | float | np.integer | np.floating) and not isinstance(name, bool):
        return numbered_quality(name if isinstance(name, int) else float(name))
    if not isinstance(name, str):
        names = ", ".join(map(repr, QUALITIES))
        raise InvalidValueError(
            f"quality: expected {names}, a number from 0 to 100 or a `splatwire.Quality`, not {shown(name)}"
        )
    if name not in QUALITIES:
        raise UnknownNameError("quality", name, tuple(QUALITIES))
    return QUALITIES[name]
