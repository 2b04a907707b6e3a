"""Options of `splatwire view`."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from splatwire.cli._options import JsonFlag, TrustOptions


@dataclass(frozen=True)
class View:
    """Show a stream in a browser, with losses, concealers, and the progress of the transfer."""

    stream: tyro.conf.Positional[str] = ""
    """Stream, udp:// or quic://HOST[:PORT][/NAME] of a server, or - for standard input. Default: the bundled scene."""
    cameras: Path | None = None
    """Cameras file; its first camera is the first view of the page."""
    host: str = "127.0.0.1"
    """Address to listen on. The default admits only this machine."""
    port: int = 8080
    """Port of the page; 0 lets the system choose."""
    open: bool = True
    """Do not open the page in a browser; its address is printed."""
    trust: TrustOptions = field(default_factory=TrustOptions)
    json: JsonFlag = False
    """Print one JSON object, with the address of the page, when it is ready."""
