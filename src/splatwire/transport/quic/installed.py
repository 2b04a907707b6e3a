"""Check for the package `aioquic`."""

import importlib.util

from splatwire.errors import BackendUnavailableError


def need_aioquic() -> None:
    """Checks that the package `aioquic` is installed.

    Raises:
        BackendUnavailableError: If the package `aioquic` is not installed.
    """
    if importlib.util.find_spec("aioquic") is None:
        raise BackendUnavailableError("aioquic", "pip install 'splatwire[relay]'")
