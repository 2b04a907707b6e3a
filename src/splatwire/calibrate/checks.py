"""Settings that make no sense are refused when they are made."""

from collections.abc import Sequence
from typing import Any

from splatwire.errors import InvalidValueError


def check_settings(settings: Any, what: str, counts: Sequence[str], **sensible: bool) -> None:
    """Refuses settings by naming all that make no sense.

    Args:
        settings: A record.
        what: What is to be done with it, for the message.
        counts: Its fields that must be 1 or more.
        sensible: Of other fields, whether the value makes sense.

    Raises:
        InvalidValueError: If a field makes no sense.
    """
    bad = [name for name in counts if getattr(settings, name) < 1]
    bad += [name for name, fine in sensible.items() if not fine]
    if bad:
        raise InvalidValueError(f"{what} cannot run with {', '.join(f'{n}={getattr(settings, n)}' for n in bad)}")
