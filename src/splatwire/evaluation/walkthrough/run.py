"""Evaluation of image quality along a camera path while a scene with levels of detail is received."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.encoding import into_datagrams
from splatwire.data import load_cameras
from splatwire.evaluation.pixels import to_pixels
from splatwire.evaluation.walkthrough.delivery import Link
from splatwire.evaluation.walkthrough.evaluation import StreamedWalkthrough, score_walk, time_to_quality
from splatwire.evaluation.walkthrough.path import Walk
from splatwire.evaluation.walkthrough.report import Pictures, decibels_text, render_walk_report
from splatwire.files.atomic_write import atomic_write
from splatwire.io import open_scene
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types.background import Background


def evaluate_path(
    stream: SceneStream, path: Path, link: Link, reference: Path, *, lossy: bool, seconds: float | None = None,
    renderer: str = "cpu", background: Background | None = None, output: Path | None = None, title: str = "walk",
    progress: Callable[[str, float], None] = lambda task, share: None,
) -> dict[str, Any]:  # fmt: skip
    """Evaluates the image quality for a viewer who moves through a scene while it is received.

    Args:
        stream: Complete stream with levels of detail.
        path: File with the cameras between which the viewer moves.
        link: Simulated network link.
        reference: File of the scene whose images are the references.
        lossy: True if `link` has losses. The stream is then divided into packets that each fit into one datagram,
            unless its packets already have a size limit.
        seconds: Duration of the walk; None for a second from each camera to the next.
        renderer: Name of the renderer.
        background: Background colour; None for the scene's.
        output: Folder of the report; None for no report.
        title: Title of the report.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Returns:
        The results as JSON values.

    Raises:
        SplatwireError: If reference or cameras cannot be read, or the stream has no levels or is not complete.
    """
    cameras, truth = load_cameras(path).relative_to(ORIGIN_SECTION.of_stream(stream)), open_scene(reference)
    warn_of_near_plane(truth, cameras)
    walk = Walk(cameras, max(cameras.num_views - 1, 1) if seconds is None else seconds)
    if lossy and not stream.manifest.packetization.hashed:
        stream = into_datagrams(stream, lambda share: progress("repacketizing", share))
    transfer = StreamedWalkthrough.of(stream, walk, link, lambda share: progress("sending in virtual time", share))
    whole = transfer.time_to_coarsest_level
    times = sorted({*walk.times, whole}) if whole <= walk.seconds else walk.times
    pictures = Pictures(walk.times)
    moments = score_walk(
        transfer, truth, walk, times, renderer=renderer,
        background=None if background is None else np.array(background),
        on_picture=None if output is None
        else lambda seconds, shown, wanted: pictures.add(seconds, to_pixels(shown), to_pixels(wanted)),
        progress=lambda share: progress("comparing pictures", share),
    )  # fmt: skip
    first = next((moment for moment in moments if moment.seconds == whole), None)
    content: dict[str, Any] = {
        "num_bytes": stream.num_bytes, "sent_bytes": transfer.head_bytes + transfer.delivery.sent_bytes,
        "rate": link.rate, "delay": link.delay, "loss": link.loss.name, "seed": link.seed,
        "first_picture": None if first is None else asdict(first), "settled_seconds": time_to_quality(moments),
        "moments": [asdict(moment) for moment in moments], "report": None,
    }  # fmt: skip
    if output is not None:
        text = f"{len(walk.times)} pictures along {walk.cameras.num_views} cameras in {walk.seconds:g} s"
        page = render_walk_report(title, text, path_facts(content), moments, pictures)
        atomic_write(output / "report.html", page.encode(), parents=True)
        content["report"] = str(output / "report.html")
    return content


def path_facts(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Formats the measured results of a simulated transfer along a camera path as names and values for a table.

    Args:
        content: The results, as stored in the JSON file.
    """
    first, at = content["first_picture"], content["settled_seconds"]
    last = content["moments"][-1]
    absent = "not within the path"
    return [
        ("link", f"{content['rate'] / 1e6:g} Mbit/s, {1e3 * content['delay']:g} ms each way, loss {content['loss']}"),
        ("first complete picture", absent if first is None else _moment(first)),
        ("final quality reached", absent if at is None else f"{at:.2f} s"),
        ("at the end", _moment(last)),
        ("received", f"{last['num_bytes']:,} of {content['num_bytes']:,} bytes"),
    ]


def _moment(moment: dict[str, Any]) -> str:
    where = f"{moment['seconds']:.2f} s: {decibels_text(moment['psnr'])}"
    return f"{where}, with the whole stream {decibels_text(moment['complete_psnr'])}; {moment['num_bytes']:,} bytes"
