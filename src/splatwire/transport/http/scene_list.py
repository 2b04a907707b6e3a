"""HTML list for the page: one link with a preview for each scene of the server."""

import base64
import html
import re
import struct
from collections.abc import Callable, Mapping

from splatwire.bitstream.sections import split_sections


def scene_list(scenes: Mapping[str, Mapping[str, str]], current: str, address: Callable[[str], str]) -> str:
    """Returns the HTML list of the server's scenes, each with a link and a preview.

    The list is empty for a single scene.

    Args:
        scenes: HTML attributes of each scene, by name (`preview_attributes`).
        current: Name of the scene that the page shows.
        address: Function that returns the URL of a scene from its name.
    """
    if len(scenes) < 2:
        return ""
    items = []
    for name, attributes in scenes.items():
        attributes_text = " ".join(f'{key}="{html.escape(value)}"' for key, value in attributes.items())
        preview = (
            f'<splat-wire-preview aria-hidden="true" {attributes_text}></splat-wire-preview>'
            if "data" in attributes
            else ""
        )
        aria_current = ' aria-current="page"' if name == current else ""
        items.append(f'<li><a href="{html.escape(address(name))}"{aria_current}>{preview}{html.escape(name)}</a></li>')
    return f'<nav aria-label="scenes"><ul>{"".join(items)}</ul></nav>'


def preview_attributes(side_info: bytes, schema_name: str, preview: bytes) -> dict[str, str]:
    """Returns the HTML attributes with a stream's preview, initial view and up axis; empty without a preview.

    Args:
        side_info: Side information of the stream (data that all packets need).
        schema_name: Name of the stream's schema.
        preview: Encoded preview; may be empty.
    """
    return {"data": base64.b64encode(preview).decode(), **start_attributes(side_info, schema_name)} if preview else {}


def start_attributes(side_info: bytes, schema_name: str) -> dict[str, str]:
    """Returns the HTML attributes of the viewer element with a stream's initial view and up axis.

    Args:
        side_info: Side information of the stream (data that all packets need).
        schema_name: Name of the stream's schema.
    """
    sections = split_sections(side_info, schema_name)[1]
    viewpoint, up = sections.get("viewpoint", b""), sections.get("up", b"")
    attributes = {"viewpoint": viewpoint_attribute(viewpoint)} if len(viewpoint) == 36 else {}
    return attributes | ({"up": up.decode()} if re.fullmatch(rb"-?[xyz]", up) else {})


def viewpoint_attribute(section: bytes) -> str:
    """Returns the HTML attribute value for a viewpoint, given the section `viewpoint` of the side information."""
    return " ".join(f"{value:.6g}" for (value,) in struct.iter_unpack("<f", section))
