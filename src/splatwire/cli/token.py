"""Options of `splatwire token`."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Token:
    """Print a signed token that opens private scenes of `serve --private` until it expires.

    The address of the scene is then `https://HOST/?stream=NAME&token=TOKEN`.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Names of the scenes that the token opens."""
    key: Path
    """File with the secret key of the server (`serve --token-key`)."""
    hours: float = 24.0
    """Validity, hours."""
    json: JsonFlag = False
    """Print one JSON object."""
