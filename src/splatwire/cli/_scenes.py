"""Options that several verbs have in common."""

from typing import TYPE_CHECKING, Literal, TypeAlias

from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.formats.outliers import Outliers
    from splatwire.scene.background import Background

BackgroundOption: TypeAlias = tuple[float, float, float] | None
"""What `--background` takes; None for the scene's own."""


def chosen_background(option: BackgroundOption) -> "Background | None":
    """Checks what the user said; None for nothing.

    Raises:
        InvalidValueError: If it is no colour.
    """
    from splatwire.scene.background import check_background

    return None if option is None else check_background(option)


OutliersOption: TypeAlias = Literal["clamp", "prune", "keep"] | None
"""Value of `--outliers`; None for the default."""


def chosen_outliers(option: OutliersOption, name: str) -> "Outliers":
    """Returns the treatment of outliers; the default where the option is absent.

    Args:
        option: Value of the option.
        name: Name of the file to write, or its ending.

    Raises:
        InvalidValueError: If the option is given for a format without shared steps.
    """
    from splatwire.formats.kinds import QUANTISED, writer_for
    from splatwire.formats.outliers import DEFAULT

    if option is None:
        return DEFAULT
    if writer_for(name) not in QUANTISED:
        raise InvalidValueError("--outliers is for compressed.ply, spz and sog: other formats keep numbers as they are")
    return option
