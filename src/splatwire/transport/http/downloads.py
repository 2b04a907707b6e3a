"""Downloads of the page server: its streams converted to other file formats."""

import json
from mmap import mmap
from typing import Any, NamedTuple, Protocol, runtime_checkable

FOLDERS = {"3dtiles": "tileset.json", "streamed-sog": "lod-meta.json"}
"""Formats that are folders with several files, and the file that a player opens first."""

TILESET = "tileset.json"
"""File of 3D Tiles that a server with one scene offers at its root, too."""


def prefixed_tileset(data: bytes, prefix: str) -> bytes:
    """Adds the folder of the tiles to all tile addresses in a `tileset.json`.

    Args:
        data: Content of the file, with addresses relative to the folder of the tiles.
        prefix: Relative URL of the folder of the tiles, with `/` at its end.
    """
    document = json.loads(data)
    waiting: list[dict[str, Any]] = [document["root"]]
    while waiting:
        tile = waiting.pop()
        tile["content"]["uri"] = prefix + tile["content"]["uri"]
        waiting += tile.get("children", [])
    return json.dumps(document, separators=(",", ":")).encode()


class DownloadedFile(NamedTuple):
    """A stream converted to another file format, as sent to clients of the page server.

    Attributes:
        data: Content of the file.
        tag: HTTP entity tag, derived from the content.
    """

    data: bytes | mmap
    tag: str


@runtime_checkable
class Downloads(Protocol):
    """Typing protocol (structural type) for a converter that offers streams for download in other file formats.

    Attributes:
        formats: Names of the supported formats, such as `spz` or `3dtiles`.
    """

    @property
    def formats(self) -> tuple[str, ...]:
        """Names of the supported formats, such as `spz` or `3dtiles`."""

    async def file(self, stream: bytes, tag: str, format_name: str, part: str = "") -> DownloadedFile | None:
        """Returns a stream in another file format, converted at the first request.

        A format such as `3dtiles` consists of a folder with several files. One of these files is returned.

        Args:
            stream: Content of the stream's `.swz` file.
            tag: HTTP entity tag of the stream.
            format_name: Name of the format, one of `formats`.
            part: Path of the requested file in the folder; empty for a format with a single file.

        Returns:
            The file; None if the folder has no file of that path.

        Raises:
            SplatwireError: If the stream cannot be converted.
        """
