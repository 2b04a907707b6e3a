"""Signed tokens that open private scenes: JSON Web Tokens (RFC 7519) with HMAC-SHA256; needs PyJWT."""

import time
from collections.abc import Sequence
from pathlib import Path

import jwt

from splatwire.errors import InvalidValueError
from splatwire.files.read_limited import read_limited

AUDIENCE, ALGORITHM = "splatwire", "HS256"
MIN_KEY_BYTES, MAX_KEY_BYTES = 32, 4096
"""Size of a secret key, bytes; HMAC-SHA256 needs 32 (RFC 7518, 3.2)."""
MAX_SECONDS = 366 * 86_400.0
"""Longest validity of a token, seconds."""
MIN_SECONDS = 1.0
"""Shortest validity of a token, seconds: the time of expiry is a whole second."""
MAX_TOKEN_BYTES = 6000
"""Largest token, bytes: it must fit into the head of a request."""


def token_problem(key: bytes, token: str, scene: str) -> str | None:
    """Returns the reason why a token does not open a scene, or None for a valid token.

    Args:
        key: Secret key of the server, with which tokens are signed.
        token: Token of a request.
        scene: Name of the requested scene.
    """
    try:
        claims = jwt.decode(token, key, algorithms=[ALGORITHM], audience=AUDIENCE, options={"require": ["exp", "aud"]})
    except jwt.ExpiredSignatureError:
        return "the token has expired"
    except jwt.InvalidTokenError:
        return "the token is not valid"
    scenes = claims.get("scenes")
    return None if isinstance(scenes, list) and scene in scenes else "the token is for other scenes"


def make_token(key: bytes, scenes: Sequence[str], seconds: float, now: float | None = None) -> str:
    """Returns a signed token that opens scenes.

    Args:
        key: Secret key of the server.
        scenes: Names of the scenes that the token opens.
        seconds: Validity, seconds.
        now: Start of the validity, seconds since 1970; None for the present time.

    Raises:
        InvalidValueError: If no scene is named, the validity is out of range, or the names of the scenes are too long
            for one token.
    """
    if not scenes:
        raise InvalidValueError("a token needs the name of a scene")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        raise InvalidValueError(
            f"a token is valid for 1 second to {MAX_SECONDS / 3600:g} hours, not for {seconds / 3600:g} hours"
        )
    expires = int((time.time() if now is None else now) + seconds)
    token = jwt.encode({"aud": AUDIENCE, "exp": expires, "scenes": list(scenes)}, key, ALGORITHM)
    if len(token) > MAX_TOKEN_BYTES:
        raise InvalidValueError(
            f"a token for these {len(scenes):,} scenes takes {len(token):,} bytes, "
            f"but at most {MAX_TOKEN_BYTES:,} fit into a request: make several tokens"
        )
    return token


def read_key(path: Path) -> bytes:
    """Reads a secret key from a file.

    Raises:
        InvalidValueError: If the file cannot be read, or the key is too short or too long.
    """
    key = read_limited(path, MAX_KEY_BYTES, InvalidValueError).strip()
    if len(key) < MIN_KEY_BYTES:
        raise InvalidValueError(
            f"{path}: a key has at least {MIN_KEY_BYTES} bytes; `openssl rand -hex 32 > {path.name}` writes one"
        )
    return key
