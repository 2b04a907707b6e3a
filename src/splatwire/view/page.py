"""Content of the web page with which `splatwire view` shows one stream in the browser."""

import base64

from splatwire.arguments import checked
from splatwire.bitstream import SceneStream, send_sequence, stream_to_bytes
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.initial_view import initial_view_section
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.origins import listens_on_loopback
from splatwire.transport.http.pack import check_page_support
from splatwire.transport.http.scene_list import viewpoint_attribute
from splatwire.types import Cameras
from splatwire.view.relay import Relay


@checked
def page_of_stream(name: str, stream: SceneStream, cameras: Cameras | None, host: str) -> PageContent:
    """Returns the page and the stream that a page server serves for one stream.

    Args:
        name: Title of the stream on the page.
        stream: Stream to show; packets may be missing.
        cameras: Cameras that determine the initial view of the page; None for that of the stream.
        host: Address that the page server listens on.

    Raises:
        InvalidValueError: If browsers cannot decode the stream.
    """
    check_page_support(stream.manifest)
    ordered = stream_to_bytes(stream.with_packets(send_sequence(stream, "tiers")))
    cameras = None if cameras is None else cameras.relative_to(ORIGIN_SECTION.of_stream(stream))
    return PageContent({name: ordered}, host=host, origins=_origins(host), attributes=_attributes(cameras))


@checked
def page_of_relay(name: str, relay: Relay, cameras: Cameras | None, host: str) -> PageContent:
    """Returns the page and the relayed stream that a page server serves during a running transfer.

    Args:
        name: Title of the stream on the page.
        relay: Relay of the running transfer.
        cameras: Cameras that determine the initial view of the page; None for that of the stream. With
            cameras, call this function after the relay has received the side information (`Relay.headed`).
        host: Address that the page server listens on.
    """
    preview = {"preview": base64.b64encode(relay.preview).decode()} if relay.preview else {}
    cameras = None if cameras is None else cameras.relative_to(relay.origin)
    return PageContent(
        {name: relay}, host=host, origins=_origins(host), attributes=preview | _attributes(cameras) | {"updates": ""}
    )


def _origins(host: str) -> tuple[str, ...] | None:
    """Returns the web origins whose pages may read the stream; None for all."""
    # Only on a loopback address, pages of other servers on this machine may read the stream.
    return None if listens_on_loopback(host) else ()


def _attributes(cameras: Cameras | None) -> dict[str, str]:
    """Returns the HTML attributes of the page's viewer element.

    `panel` opens the settings panel; `viewpoint`, if cameras are given, sets the initial view.
    """
    begins = {} if cameras is None else {"viewpoint": viewpoint_attribute(initial_view_section(cameras))}
    return {"panel": "open", **begins}
