"""Validation of the concealer names that options contain."""

from splatwire.concealment import create_concealer
from splatwire.concealment.temporal.concealers import BUILT_IN, temporal_concealer
from splatwire.errors import UnknownNameError


def check_concealer(name: str) -> None:
    """Raises an error if neither static scenes nor clips have a concealer of the given name.

    Raises:
        UnknownNameError: If there is no such concealer.
    """
    if name in BUILT_IN:
        return
    try:
        create_concealer(name)
    except UnknownNameError as error:
        try:
            temporal_concealer(name)
        except UnknownNameError:
            raise error from None
