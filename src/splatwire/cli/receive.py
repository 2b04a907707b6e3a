"""Options of `splatwire receive`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag, TrustOptions

EXPLICIT_SUFFIXES = (".ply", ".spz", ".sog", ".splat")
"""File name suffixes of the formats of explicit Gaussians."""


@dataclass(frozen=True)
class Receive:
    """Receive a stream over UDP or QUIC; the packets received before a deadline form a scene or its preview."""

    url: tyro.conf.Positional[str]
    """udp://HOST[:PORT][/NAME], quic://HOST[:PORT][/NAME][?token=TOKEN] or moq://RELAY[:PORT][/PATH]/NAME."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if the name ends in .swz (or is -), otherwise a folder of packets. Live clips: a new
    folder with one PLY per frame, written as soon as the frame is complete; with .swz one file per period, the last one
    under this name, earlier ones as NAME.000.swz and so on. With --conceal a scene file; names that end in .ply, .spz,
    .sog or .splat get explicit Gaussians. If only the preview arrived, it is written as NAME.preview.ply."""
    deadline: str | None = None
    """Time after which the received packets are written, e.g. 2s or 500ms. Default: wait for all packets. If packets
    are missing, the exit status is 3 without --partial. Ctrl-C writes the received packets, too."""
    partial: bool = False
    """Exit with status 0 even if packets are missing; without it the status is 3. Received packets are written in both
    cases. With --camera, only packets that the camera sees count; of a live clip that has ended, only those since this
    receiver joined. If the server stops sending, the receiver first reconnects for up to a minute and resumes the
    transfer."""
    follow: bool = False
    """Keep receiving updates of the scene (`serve --updates`) until Ctrl-C. The output is written again after each
    update. If an update does not arrive, the last scene remains, and a warning says so. A server without updates of the
    scene is an error."""
    no_nack: bool = False
    """Do not request retransmission of lost packets."""
    camera: Path | None = None
    """Cameras file, for a stream with levels: receive only the tiles that its first camera sees."""
    conceal: str | None = None
    """Decode the stream, conceal losses with this concealer (drop, prior, idw, cari, grow, ...), and write a scene
    file. Clips (drop, hold, motion, ...): a folder with one PLY per frame."""
    trust: TrustOptions = field(default_factory=TrustOptions)
    pcap: Path | None = None
    """Write all datagrams, sent and received, to this file in the format of tcpdump."""
    json: JsonFlag = False
    """Print one JSON object; with --follow one per line for each state of the scene."""

    @property
    def explicit(self) -> bool:
        """True if the suffix of the output is that of a format of explicit Gaussians."""
        return Path(self.output).suffix.lower() in EXPLICIT_SUFFIXES
