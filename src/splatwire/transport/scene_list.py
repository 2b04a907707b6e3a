"""The list of scenes above a page's element, where there are several: a link for each, with its preview."""

import base64
import html
import re
import struct
from collections.abc import Callable, Mapping

from splatwire.packets.sections import split_sections


def scene_list(scenes: Mapping[str, Mapping[str, str]], current: str, address: Callable[[str], str]) -> str:
    """Writes the list; nothing for a single scene.

    Args:
        scenes: What is told of each by its name (`told_of`), as attributes of a `<splat-wire-preview>`.
        current: Name of the one that is shown.
        address: Where each is to be had.
    """
    if len(scenes) < 2:
        return ""
    items = []
    for name, told in scenes.items():
        words = " ".join(f'{key}="{html.escape(value)}"' for key, value in told.items())
        seen = f'<splat-wire-preview aria-hidden="true" {words}></splat-wire-preview>' if "data" in told else ""
        here = ' aria-current="page"' if name == current else ""
        items.append(f'<li><a href="{html.escape(address(name))}"{here}>{seen}{html.escape(name)}</a></li>')
    return f'<nav aria-label="scenes"><ul>{"".join(items)}</ul></nav>'


def told_of(side_info: bytes, codec: str, preview: bytes) -> dict[str, str]:
    """A stream's preview, and from where it is looked at, as elements of pages are told; nothing without a preview.

    Args:
        side_info: The stream's side information.
        codec: Its schema.
        preview: Its preview, which may be empty.
    """
    return {"data": base64.b64encode(preview).decode(), **begins(side_info, codec)} if preview else {}


def begins(side_info: bytes, codec: str) -> dict[str, str]:
    """Where a stream says to begin and what is up, as elements of pages are told."""
    sections = split_sections(side_info, codec)[1]
    viewpoint, up = sections.get("viewpoint", b""), sections.get("up", b"")
    found = {"viewpoint": viewpoint_words(viewpoint)} if len(viewpoint) == 36 else {}
    return found | ({"up": up.decode()} if re.fullmatch(rb"-?[xyz]", up) else {})


def viewpoint_words(section: bytes) -> str:
    """Where a page begins, as its element is told: the numbers of a stream's section `viewpoint`."""
    return " ".join(f"{value:.6g}" for (value,) in struct.iter_unpack("<f", section))
