"""The page of `splatwire view`: that of `serve --page`, of one stream on this machine."""

import base64

from splatwire.codec.origin import origin_of_stream
from splatwire.codec.viewpoint import viewpoint_section
from splatwire.packets import SceneStream, send_sequence, stream_to_bytes
from splatwire.scene import Cameras
from splatwire.transport.origins import is_loopback
from splatwire.transport.page_content import PageContent
from splatwire.transport.scene_list import viewpoint_words
from splatwire.view.columns import columns_of
from splatwire.view.relay import Relay


def page_of_stream(name: str, stream: SceneStream, cameras: Cameras | None, host: str) -> PageContent:
    """The page of a stream.

    Args:
        name: What the page calls it.
        stream: The stream; packets that it lacks are concealed by the page.
        cameras: Where the page begins; None where the stream says, or outside.
        host: The address that the page is served on.

    Raises:
        BitstreamError: If it has to be decoded here, and contradicts itself.
    """
    shown = stream if stream.manifest.schema.page else columns_of(stream)
    ordered = stream_to_bytes(shown.with_packets(send_sequence(shown, "tiers")))
    cameras = None if cameras is None else cameras.relative_to(origin_of_stream(stream))
    return PageContent({name: ordered}, host=host, origins=_origins(host), attributes=_attributes(cameras))


def page_of_relay(name: str, relay: Relay, cameras: Cameras | None, host: str) -> PageContent:
    """The page of a transfer that has begun.

    Args:
        name: What the page calls it.
        relay: The transfer.
        cameras: Where the page begins; None where the stream says, or outside.
        host: The address that the page is served on.
    """
    preview = {"preview": base64.b64encode(relay.preview).decode()} if relay.preview else {}
    return PageContent({name: relay}, host=host, origins=_origins(host), attributes=preview | _attributes(cameras))


def _origins(host: str) -> tuple[str, ...] | None:
    """Pages of others that may read the stream: those of this machine, none where other machines reach the server."""
    return None if is_loopback(host) else ()


def _attributes(cameras: Cameras | None) -> dict[str, str]:
    """What the page's element is told: where it begins, and that its laboratory is open."""
    begins = {} if cameras is None else {"viewpoint": viewpoint_words(viewpoint_section(cameras))}
    return {"panel": "open", **begins}
