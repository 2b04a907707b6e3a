"""Checks of option values common to several subcommands."""

from splatwire.cli._options import BackgroundOption, OutliersOption
from splatwire.errors import InvalidValueError
from splatwire.io.formats import format_for
from splatwire.io.formats.outliers import DEFAULT, Outliers
from splatwire.types.background import Background, check_background


def chosen_background(option: BackgroundOption) -> Background | None:
    """Returns the background colour of the option `--background`, or None if the option is not set.

    Raises:
        InvalidValueError: If the value is not a colour.
    """
    return None if option is None else check_background(option)


def chosen_outliers(option: OutliersOption, name: str) -> Outliers:
    """Returns the treatment of outliers for a file format; the default treatment if the option is not set.

    Args:
        option: Value of the option.
        name: Name of the output file, or its suffix.

    Raises:
        InvalidValueError: If the format does not support this option.
    """
    if option is None:
        return DEFAULT
    if "outliers" not in format_for(name).write_options:
        raise InvalidValueError("--outliers is for compressed.ply, spz and sog: other formats keep numbers as they are")
    return option
