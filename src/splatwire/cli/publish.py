"""Options of `splatwire publish`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Publish:
    """Write the folder of a static web site that shows scenes: pages, player, streams, thumbnails, and headers.

    The folder needs no server program: copy it to a web host, a bucket or a CDN.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Streams (.swz), or files that are encoded first: explicit Gaussians (PLY, SPZ, SOG, ...), folders of frames. The
    first one is index.html, each other one NAME.html."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write; one that `publish` wrote before is updated, and keeps its former streams."""
    public_url: str | None = None
    """Address of the site, e.g. https://example.org/splats, for previews of links in other programs."""
    no_thumbnails: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write no thumbnails."""
    json: JsonFlag = False
    """Print one JSON object."""
