"""Validation of the fields of settings dataclasses."""

from collections.abc import Sequence
from typing import Any

from splatwire.errors import InvalidValueError


def check_settings(settings: Any, operation: str, counts: Sequence[str], **sensible: bool) -> None:
    """Raises an error if a field of a settings object is invalid.

    Args:
        settings: A dataclass instance.
        operation: Name of the operation that uses the settings, for the error message.
        counts: Names of fields that must be at least 1.
        **sensible: Results of the caller's own checks of other fields, by field name: True for a valid value.

    Raises:
        InvalidValueError: If a field is invalid; the message names all invalid fields.
    """
    bad = [name for name in counts if getattr(settings, name) < 1]
    bad += [name for name, fine in sensible.items() if not fine]
    if bad:
        raise InvalidValueError(f"{operation} cannot run with {', '.join(f'{n}={getattr(settings, n)}' for n in bad)}")
