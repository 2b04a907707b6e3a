"""Options of `splatwire serve`."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from splatwire.cli._options import Listening, RelayTrustOptions


@dataclass(frozen=True)
class Serve(Listening):
    """Serve streams over UDP or QUIC to many clients at once; stop with Ctrl-C."""

    streams: tyro.conf.Positional[tuple[str, ...]] = ()
    """Streams: .swz files or folders. Default: the Gaussians of the bundled scene. A stream of another preset than
    datagram is repacketized first, with the same content. A client selects a stream by its file name without the
    suffix; without a name it gets the first."""
    origins: tuple[str, ...] = ()
    """With --quic: web pages that may read streams and open sessions, e.g. https://example.org. Default: all pages;
    only pages of this machine if --host is a loopback address and --public-url is not given."""
    downloads: tuple[str, ...] = ()
    """With --page: formats in which still scenes of explicit Gaussians are offered to other programs, as /NAME.spz:
    ply, spz, sog, glb, splat, and the folders 3dtiles (/NAME/3dtiles/tileset.json) and streamed-sog. A file is made at
    its first request, and the page has links to it. If one scene is served, /tileset.json is its tileset."""
    private: tuple[str, ...] = ()
    """With --quic or --page: names of scenes that need a token (`splatwire token`); they are listed nowhere."""
    token_key: Path | None = None
    """With --private: file with the secret key that tokens are signed with, 32 bytes or more."""
    unlisted: tuple[str, ...] = ()
    """With --page: names of scenes that the page does not list; their address opens them."""
    idle: float = 5.0
    """Time without a datagram from a client after which its transfer ends, seconds."""
    drain: float = 0.0
    """Time after SIGTERM or Ctrl-C for which running transfers may continue, seconds; new ones are refused."""
    plan: Path | None = None
    """Protection of this stream: a file that `splatwire plan -o FILE` wrote."""
    init_repair: float | None = None
    """Without --plan: repair symbols per symbol of the side information, default 0.35."""
    protect: tuple[str, ...] = ()
    """Without --plan: repair symbols per packet of a tier, tierN=REPAIR, e.g. tier0=0.4. A stream encoded without
    --tiers has only tier 0. motion=REPAIR: repair symbols per motion packet of a clip."""
    config: Path | None = None
    """TOML file with options of this verb by name, e.g. page = 8080 or streams = ["room.swz"]. Options of the command
    line win."""
    updates: Path | None = None
    """Folder that is watched for updates of the served scenes (`encode --update`). Each is applied when it appears:
    connected receivers (`receive --follow`) and pages get the update, new ones the changed scene."""
    moq: str | None = None
    """https://RELAY[:PORT]/NAME of a relay of Media over QUIC. One stream is published there, clients receive it from
    the relay, and the server itself does not listen."""
    trust: RelayTrustOptions = field(default_factory=RelayTrustOptions)
