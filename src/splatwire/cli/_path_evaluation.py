"""`splatwire evaluate --path`: what somebody sees who walks through a scene with levels while it arrives."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from splatwire.cli._output import refuse_options
from splatwire.cli._terminal import print_table
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.cli._evaluate_options import EvaluateOptions
    from splatwire.cli._output import Reporter
    from splatwire.levels.delivery import Link
    from splatwire.packets import SceneStream

UNIT = "datagram"
FACTORS = {"k": 1e3, "M": 1e6, "G": 1e9}
_OTHERS = ("data", "cameras", "conceal", "contiguous", "views", "lpips_views")
"""Options that a path has no use for."""
ONLY_HERE = ("rate", "delay", "seconds")
"""Options that only a path has a use for."""


def parse_rate(text: str) -> float:
    """Bits per second of a text such as `10M` or `800k`.

    Raises:
        InvalidValueError: If it is no rate.
    """
    number, factor = (text[:-1], FACTORS[text[-1]]) if text[-1:] in FACTORS else (text, 1.0)
    try:
        return float(number) * factor
    except ValueError:
        raise InvalidValueError(f"--rate takes bits per second, such as 10M, 800k or 2.5e6, not {text!r:.40}") from None


def check_path_options(options: "EvaluateOptions") -> None:
    """Tells what is wrong with the options before any work.

    Raises:
        InvalidValueError: If they are not for a path.
    """
    if options.path is None:
        refuse_options(options, ONLY_HERE, "is for a walk through a scene with levels: give --path CAMERAS")
        return
    refuse_options(options, _OTHERS, "means nothing together with --path")
    if options.reference is None:
        raise InvalidValueError("pictures along a path are compared with those of --reference SCENE")
    if len(options.seeds) > 1:
        raise InvalidValueError("--path takes one seed")
    link_of(options)


def link_of(options: "EvaluateOptions") -> "Link":
    """The link that the options describe."""
    from splatwire.channel import parse_loss
    from splatwire.levels.delivery import Link

    if options.rate is None:
        raise InvalidValueError("--path needs the --rate of the link, such as 10M")
    loss = parse_loss(options.loss or "none", UNIT)
    delay = 0.02 if options.delay is None else options.delay / 1e3
    return Link(parse_rate(options.rate), delay, loss, *options.seeds)


def evaluate_path(options: "EvaluateOptions", stream: "SceneStream", report: "Reporter") -> dict[str, Any]:
    """Walks along a path; what `--json` prints.

    Raises:
        SplatwireError: If reference or cameras cannot be read, or the stream has no levels or is not complete.
    """
    from splatwire.cli._datagrams import into_datagrams
    from splatwire.cli._scenes import chosen_background
    from splatwire.codec.origin import origin_of_stream
    from splatwire.data import load_cameras
    from splatwire.evaluate.pixels import to_pixels
    from splatwire.files.whole import write_whole
    from splatwire.levels.journey import Journey, score_walk, settled
    from splatwire.levels.walk import Walk
    from splatwire.levels.walk_report import Pictures, render_walk_report
    from splatwire.scene_io import open_scene

    assert options.path is not None
    assert options.reference is not None
    cameras, link = load_cameras(options.path).relative_to(origin_of_stream(stream)), link_of(options)
    walk = Walk(cameras, max(cameras.num_views - 1, 1) if options.seconds is None else options.seconds)
    if options.loss and not stream.manifest.packetization.hashed:  # as it is sent where datagrams are lost
        stream = into_datagrams(stream, report)
    journey = Journey.of(stream, walk, link, lambda share: report("sending in virtual time", share))
    reference, background = open_scene(options.reference), chosen_background(options.background)
    whole = journey.whole_at
    times = sorted({*walk.times, whole}) if whole <= walk.seconds else walk.times
    pictures = Pictures(walk.times)
    moments = score_walk(
        journey, reference, walk, times, renderer=options.renderer,
        background=None if background is None else np.array(background),
        on_picture=None if options.output is None
        else lambda seconds, shown, truth: pictures.add(seconds, to_pixels(shown), to_pixels(truth)),
        progress=lambda share: report("comparing pictures", share),
    )  # fmt: skip
    first = next((moment for moment in moments if moment.seconds == whole), None)
    content: dict[str, Any] = {
        "num_bytes": stream.num_bytes, "sent_bytes": journey.head_bytes + journey.delivery.sent_bytes,
        "rate": link.rate, "delay": link.delay, "loss": link.loss.name, "seed": link.seed,
        "first_picture": None if first is None else asdict(first), "settled_seconds": settled(moments),
        "moments": [asdict(moment) for moment in moments], "report": None,
    }  # fmt: skip
    if options.output is not None:
        text = f"{len(walk.times)} pictures along {walk.cameras.num_views} cameras in {walk.seconds:g} s"
        page = render_walk_report(Path(options.source).name, text, path_facts(content), moments, pictures)
        write_whole(options.output / "report.html", page.encode())
        content["report"] = str(options.output / "report.html")
    return content


def path_facts(content: dict[str, Any]) -> list[tuple[str, str]]:
    """What tables say of a walk."""
    first, at = content["first_picture"], content["settled_seconds"]
    last = content["moments"][-1]
    told = "not within the path"
    return [
        ("link", f"{content['rate'] / 1e6:g} Mbit/s, {1e3 * content['delay']:g} ms each way, loss {content['loss']}"),
        ("whole scene at some level", told if first is None else _moment(first)),
        ("settled", told if at is None else f"{at:.2f} s"),
        ("at the end", _moment(last)),
        ("came of the stream", f"{last['num_bytes']:,} of {content['num_bytes']:,} bytes"),
    ]


def _moment(moment: dict[str, Any]) -> str:
    from splatwire.levels.walk_report import decibels_text

    where = f"{moment['seconds']:.2f} s: {decibels_text(moment['psnr'])}"
    return f"{where}, with everything {decibels_text(moment['complete_psnr'])}; {moment['num_bytes']:,} bytes"


def print_path_facts(content: dict[str, Any], title: str) -> None:
    """Prints what was seen as a table on standard output."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=False)
    for name, value in path_facts(content):
        table.add_row(name, value)
    print_table(table)
