"""Scene properties in the header comments of a PLY."""

import logging
import re
from collections.abc import Iterable
from pathlib import Path

from splatwire.errors import InvalidValueError
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin, describe_origin

LOG = logging.getLogger(__name__)
ORIGIN, OFFSET = "splatwire-origin", "splatwire-offset"
"""Keywords of comments. `splatwire-origin X Y Z`: coordinates in the file are absolute, and encoded streams are
relative to this point. `splatwire-offset X Y Z`: coordinates in the file are relative to this point."""
ANTIALIASED = "SplatRenderMode: mip"
_SWITCH = re.compile(
    r"(?:(?:use|with|enable|is)[-_ ]?)?"
    r"(?:anti[-_ ]?alias(?:ed|ing)?|mip[-_ ]?(?:splat(?:s|ting)?|filter(?:ed|ing)?)|mip|aa)(?:\s*[:=]\s*|\s+|$)(\S*)",
    re.I,
)
_MODE = re.compile(
    r"(?:splat[-_ ]?)?(?:render(?:ing|er)?|raster(?:i[sz](?:e|er|ation))?)[-_ ]?mode(?:\s*[:=]\s*|\s+)(\S.*)", re.I
)
_OTHER_MODE = re.compile(
    r"(?:(?:splat|gaussian|3dgs|render(?:ing|er)?|raster(?:i[sz](?:e|er|ation))?|train(?:ed|ing)?|config|pipeline|model"
    r"|with|using)[-_. ]*)*mode(?:l\s*[:=]\s*|\s*[:=]\s*|\s+)(\S.*)",
    re.I,
)
"""Pattern of comments with a mode of splats under another name, of which only antialiasing is known.

PlayCanvas' splat-transform names the mode `model` in SOG. Modes of other things, such as textures, do not match.
"""
_YES = frozenset(("", "1", "1.0", "true", "yes", "on", "enabled"))
_NO = frozenset(("0", "0.0", "false", "no", "off", "none", "disabled"))
_CLASSIC = re.compile(r"default|classic|normal|standard|vanilla|3dgs|gaussian|none|off|0|false|no", re.I)
_ABOUT = re.compile(
    r"anti[-_ ]?alias|(?:\b|_)mip[-_ ]?(?:splat|filter)|splat[-_ ]?render[-_ ]?mode|raster\w*[-_ ]?mode"
    r"|\b(?:kernel|filter)[-_ ]?size|\b(?:2d|low[-_ ]?pass|smoothing)[-_ ]?filter|\bfilter[-_ ]?2d|\blow[-_ ]?pass\b"
    r"|\beps[-_ ]?2d|\bdilation|\bopacity[-_ ]?compensation|\bcompensat"
    r"|[:=\s][\"']?mip[\"']?\W*$|\bmodel\s*[:=]\s*[\"']?2dgs\b",
    re.I,
)
"""Pattern of comments that refer to antialiasing, or to another way of drawing (2DGS)."""
_MIP = re.compile(r"(?:mip[-_ ]?(?:splat(?:s|ting)?|filter(?:ed|ing)?)?|anti[-_ ]?alias(?:ed|ing)?)", re.I)


def states_antialiasing(comments: Iterable[str]) -> bool:
    """True if header comments state that the scene was trained with antialiasing.

    Args:
        comments: Text of each comment, without the word `comment`.
    """
    stated = [answer for comment in comments if (answer := _antialiasing_setting(comment)) is not None]
    return bool(stated) and stated[-1]


def warn_of_unclear_antialiasing(
    path: Path, comments: Iterable[str], kind: str = "comment", *, drawn_with_it: bool | None = None
) -> None:
    """Logs a warning about comments on antialiasing that cannot be parsed, or that contradict each other.

    Args:
        path: The file.
        comments: Text of each comment, without the word `comment`.
        kind: Name of the comments in messages.
        drawn_with_it: True if the scene is drawn with antialiasing; None if these comments decide it.
    """
    all_comments = tuple(comments)
    with_it = states_antialiasing(all_comments) if drawn_with_it is None else drawn_with_it
    drawn = "with" if with_it else "without"
    if {True, False} <= {_antialiasing_setting(comment) for comment in all_comments}:
        LOG.warning("%s: %ss enable and disable antialiasing: the scene is drawn %s it", path, kind, drawn)
    for comment in all_comments:
        if _ABOUT.search(comment) and _antialiasing_setting(comment) is None:
            LOG.warning(
                "%s: %s %.80r is not understood: the scene is drawn %s antialiasing", path, kind, comment, drawn
            )


def is_antialiasing_unclear(comments: Iterable[str]) -> bool:
    """Returns True if comments on antialiasing cannot be parsed, or contradict each other."""
    settings = [(comment, _antialiasing_setting(comment)) for comment in comments]
    if {True, False} <= {setting for _, setting in settings}:
        return True
    return any(setting is None and _ABOUT.search(comment) for comment, setting in settings)


def fields_as_comments(fields: object) -> list[str]:
    """Returns the fields of a JSON object that are text, numbers or flags in the form of comments: `name: value`.

    Args:
        fields: The object; the list is empty for any other value.
    """
    values = fields.items() if isinstance(fields, dict) else ()
    return [f"{name:.80}: {str(value)[:80]}" for name, value in values if isinstance(value, (str, int, float))]


def _antialiasing_setting(comment: str) -> bool | None:
    """Returns the antialiasing setting that a PLY comment states: True, False, or None without a setting."""
    text = comment.strip().rstrip(".;,").replace('"', "").replace("'", "")
    if mode := _MODE.fullmatch(text):
        kind = mode[1].strip()
        return True if _MIP.fullmatch(kind) else False if _CLASSIC.fullmatch(kind) else None
    if (mode := _OTHER_MODE.fullmatch(text)) and _MIP.fullmatch(mode[1].strip()):
        return True
    if (switch := _SWITCH.fullmatch(text)) and switch[1].lower() in _YES | _NO:
        return switch[1].lower() in _YES
    return None


def antialiasing_comments(antialiased: bool) -> list[str]:
    """Returns the PLY comments that declare antialiasing; an empty list for a scene without antialiasing."""
    return [ANTIALIASED] if antialiased else []


def origin_comments(keyword: str, origin: Origin) -> list[str]:
    """Returns a list with the PLY comment that states a scene's origin.

    The list is empty for the origin (0, 0, 0).

    Args:
        keyword: First word of the comment: `ORIGIN` or `OFFSET`.
        origin: World coordinates of the origin.
    """
    return [] if origin == NO_ORIGIN else [f"{keyword} {describe_origin(origin)}"]


def stated_origin(keyword: str, comments: Iterable[str]) -> Origin | None:
    """Returns the origin in the first valid PLY comment that starts with `keyword`; None without such a comment."""
    for comment in comments:
        words = comment.split()
        if words[:1] != [keyword]:
            continue
        try:
            return check_origin([float(word) for word in words[1:]])
        except (InvalidValueError, ValueError):
            continue
    return None
