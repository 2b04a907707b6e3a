"""Options of `splatwire live`."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from splatwire.cli._options import Listening


@dataclass(frozen=True)
class Live(Listening):
    """Encode frames as they appear, and serve them at once; stops at Ctrl-C or, with -, when standard input ends."""

    frames: tyro.conf.Positional[str]
    """Folder into which another program writes one file per frame, with names in order of time; or - to read the names
    of such files, one per line, from standard input. Unreadable frames are skipped, and frames that arrive faster than
    they can be encoded are dropped; both are reported. Write files elsewhere and move them into the folder, so that
    none is read before it is complete."""
    fps: float | None = None
    """Frames per second, default 30. Frames that are in the folder already are encoded at this rate, too."""
    group: int | None = None
    """Length of a group of frames (GOP), 1 to 64 frames, default 15. It delays the stream by its duration, and a lost
    motion packet affects one group."""
    quality: str | None = None
    """Quantisation quality, 0 (smallest) to 100 (finest), or a name: small (40), default (60) or near-lossless (85)."""
    plan: Path | None = None
    """Parity for each group of frames: a file that `splatwire plan -o FILE` wrote for a similar recording. The
    plan begins again with each period: after 120 groups or 64 MiB, or when the encoder starts again."""
    protect: tuple[str, ...] = ()
    """Without --plan: motion=REPAIR, the number of repair symbols per motion packet."""
