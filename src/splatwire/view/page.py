"""The page of `splatwire view`: a stream that the browser draws, or pictures of one that it does not."""

from collections.abc import Callable

from splatwire.codec.viewpoint import viewpoint_section
from splatwire.conceal import concealer_names
from splatwire.packets import SceneStream, send_sequence, stream_to_bytes
from splatwire.render.importance import cameras_around
from splatwire.scene import Cameras
from splatwire.scene.background import Background
from splatwire.transport.page_content import PICTURE, PageContent, viewpoint_words
from splatwire.view.model import Settings, Source, Viewer
from splatwire.view.pictures import Pictures

AROUND = 8
"""Views around a scene without cameras, the middle one of which the page begins with."""


def page_of_stream(stream: SceneStream, cameras: Cameras | None, host: str) -> PageContent:
    """The page of a stream that the browser decodes and draws.

    Args:
        stream: The stream; packets that it lacks are concealed by the page.
        cameras: Where the page begins; None where the stream says, or outside.
        host: The address that the page is served on.
    """
    ordered = stream.with_packets(send_sequence(stream, "tiers"))
    attributes = {} if cameras is None else {"viewpoint": viewpoint_words(viewpoint_section(cameras))}
    return PageContent({"scene": stream_to_bytes(ordered)}, host=host, attributes=attributes)


def page_of_pictures(
    source: Source,
    cameras: Cameras | None,
    host: str,
    renderer: str,
    background: Background | None,
    progress: Callable[[str, float], None],
) -> PageContent:
    """The page of a stream that the renderer draws, picture by picture; the first one is drawn at once.

    Args:
        source: Where the scene comes from.
        cameras: Where the page begins; None begins outside.
        host: The address that the page is served on.
        renderer: Name of the renderer.
        background: RGB behind everything; None for what the scene was trained in front of.
        progress: Called with what is done, and its share.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: The renderer cannot run here.
    """
    viewer = Viewer(source, renderer, background)
    progress("drawing a picture", 0.0)  # what is compiled for the first one is, before anybody looks
    viewer.frame(Settings(0.0), cameras_around(source.positions, 1, 96))
    progress("drawing a picture", 1.0)
    around = cameras_around(source.positions, AROUND)
    begin = cameras or around.select([AROUND // 2, *range(AROUND)])
    names = source.progressive.concealers if source.progressive else concealer_names()
    attributes = {
        "pictures": PICTURE,
        "viewpoint": viewpoint_words(viewpoint_section(begin)),
        "concealers": " ".join(names),
    }
    if source.pending:
        attributes["live"] = ""
    return PageContent({}, host=host, attributes=attributes, pictures=Pictures(viewer).answer)
