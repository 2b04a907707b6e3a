"""Statements about all Gaussians of a PLY in the comments of its header.

Brush, gsplat and nerfstudio write `SplatRenderMode: mip`, Postshot `antialiased 1`. An origin is our own comment.
"""

import re
from collections.abc import Iterable

from splatwire.errors import InvalidValueError
from splatwire.scene.origin import NO_ORIGIN, Origin, check_origin, describe_origin

ORIGIN, OFFSET = "splatwire-origin", "splatwire-offset"
"""`splatwire-origin X Y Z`: coordinates are absolute, streams of them are relative to this point.
`splatwire-offset X Y Z`: coordinates in the file are relative to this point."""
ANTIALIASED = "SplatRenderMode: mip"
_SWITCH = re.compile(
    r"(?:anti[-_ ]?alias(?:ed|ing)?|mip[-_ ]?(?:splat(?:s|ting)?|filter(?:ed|ing)?)|mip)(?:\s*[:=]\s*|\s+|$)(\S*)", re.I
)
_MODE = re.compile(
    r"(?:splat[-_ ]?)?(?:render(?:ing|er)?|raster(?:i[sz](?:e|er|ation))?)[-_ ]?mode(?:\s*[:=]\s*|\s+)(\S.*)", re.I
)
_YES = frozenset(("", "1", "1.0", "true", "yes", "on", "enabled"))
_NO = frozenset(("0", "0.0", "false", "no", "off", "none", "disabled"))
_MIP = re.compile(r"(?:mip[-_ ]?(?:splat(?:s|ting)?|filter(?:ed|ing)?)?|anti[-_ ]?alias(?:ed|ing)?)", re.I)


def states_antialiasing(comments: Iterable[str]) -> bool:
    """Returns True if the last comment about antialiasing switches it on.

    Args:
        comments: Text of each comment, without the word `comment`.
    """
    found = False
    for comment in comments:
        text = comment.strip().rstrip(".;,").replace('"', "").replace("'", "")
        if mode := _MODE.fullmatch(text):
            found = _MIP.fullmatch(mode[1].strip()) is not None
        elif (switch := _SWITCH.fullmatch(text)) and switch[1].lower() in _YES | _NO:
            found = switch[1].lower() in _YES
    return found


def antialiasing_comments(antialiased: bool) -> list[str]:
    """Returns the comment for antialiasing; none if `antialiased` is False."""
    return [ANTIALIASED] if antialiased else []


def origin_comments(keyword: str, origin: Origin) -> list[str]:
    """Returns the comment with an origin; none for (0, 0, 0).

    Args:
        keyword: `ORIGIN` or `OFFSET`.
        origin: The origin.
    """
    return [] if origin == NO_ORIGIN else [f"{keyword} {describe_origin(origin)}"]


def stated_origin(keyword: str, comments: Iterable[str]) -> Origin | None:
    """Returns the origin in a comment that starts with `keyword`; None if there is none, or it is no origin."""
    for comment in comments:
        words = comment.split()
        if words[:1] != [keyword]:
            continue
        try:
            return check_origin([float(word) for word in words[1:]])
        except (InvalidValueError, ValueError):
            return None
    return None
