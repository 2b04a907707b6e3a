"""Implementation of `splatwire demo`: encoding, loss, decoding and evaluation of the bundled scene."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from splatwire.bitstream import SceneStream, read_stream
from splatwire.bitstream.sections import sections_of
from splatwire.cli import _subprocess
from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE, SPLATS
from splatwire.cli._files import check_folder
from splatwire.cli._output import print_json, progress_bars
from splatwire.cli._table import print_rows
from splatwire.cli.demo import Demo
from splatwire.codec import decode_stream, schema_named
from splatwire.concealment import concealer_names
from splatwire.evaluation.study import Loss, SceneEntry, Study, concealment_rows, run_plain_study
from splatwire.types.received_scene import ReceivedScene

_LPIPS_VIEWS = 2
"""Number of views for LPIPS, which takes seconds per image on a CPU; with two the demo takes under two minutes."""
_NOTES = (
    "A compressed scene was split into independently decodable packets, some of them were lost, a fresh process "
    "decoded what had arrived, each concealer dealt with the gaps, and the CPU renderer drew the test views.",
    "The reference pictures are the lossless scene's own renders, not photos: the numbers say what the losses cost. "
    "The row contiguous drop is the same scene with packets of neighbouring anchors; all others use stratified lanes.",
    "The paper's network has no row: on this scene it learns nothing beyond kriging (docs/cari-findings.md).",
)


def run(command: Demo) -> None:
    """Runs `splatwire demo`: measures the quality of a scene after packet losses, and writes a report."""
    started = time.perf_counter()
    check_folder(command.output)
    definition = study(command)
    command.output.mkdir(exist_ok=True)  # the other process makes a folder in it, perhaps before this one writes
    with progress_bars() as show, _explicit(command) as other:
        links = {"The same with explicit Gaussians": "explicit/report.html"}
        result, content = run_plain_study(definition, command.output, show, decode=_decode, links=links)
        show("explicit Gaussians, in another process", 0.0)
        explicit = other()
    seconds = time.perf_counter() - started
    if command.json:
        print_json({**content, "demo_seconds": seconds, "explicit": explicit})
        return

    print_rows(content["rows"], result.study.title, lpips_note=result.lpips_note)
    print(f"report: {content['report']}")
    title = f"the same of explicit Gaussians, as any splat file holds them: {SPLATS}, made from the same photos"
    print_rows(explicit["rows"], title, lpips_note=result.lpips_note)
    print(f"report: {explicit['report']}")
    print(f"PSNR is against the lossless scene's own renders. {seconds:.0f} s in all.")


@contextmanager
def _explicit(command: Demo) -> Iterator[Callable[[], dict[str, Any]]]:
    """Context manager that evaluates the bundled file of explicit Gaussians in a separate process.

    Yields:
        Function that waits for the end of the evaluation and returns its result.
    """
    source = ASSETS / SPLATS
    views = () if command.views is None else ("--views", command.views)
    with _subprocess.in_fresh_process(
        "evaluate", source, "--reference", source, "--cameras", ASSETS / CAMERAS, "--loss", command.loss,
        "--seeds", command.seed, "--lpips-views", _LPIPS_VIEWS, *views, "-o", command.output / "explicit",
    ) as answer:  # fmt: skip
        yield answer


def study(command: Demo) -> Study:
    """Returns the definition of the demo's evaluation."""
    source = ASSETS / SCENE
    stream, _ = read_stream(source)
    concealers = concealer_names(sections_of(stream), schema_named(stream.manifest.schema_name).provides)
    contiguous = replace(stream.manifest.packetization, grouping="contiguous")
    loss = Loss(command.loss)
    return Study(
        name=source.stem,
        title=f"splatwire demo: {source.stem} under {loss.process.name}",
        scenes=(SceneEntry(source.stem, source, "stream", cameras=ASSETS / CAMERAS),),
        rows=concealment_rows(concealers, contiguous=contiguous),
        losses=(loss,),
        seeds=(command.seed,),
        notes=_NOTES,
        baseline="drop",
        views=command.views,
        lpips_views=_LPIPS_VIEWS,
    )


def _decode(stream: SceneStream) -> ReceivedScene:
    """Decodes a received stream of the demo. A stream with losses is decoded in a new process."""
    # The new process proves that decoding needs nothing but the received bytes. The stream with contiguous packets,
    # which is only shown for comparison, is decoded here.
    manifest = stream.manifest
    is_valid = len(stream.packets) == manifest.num_packets or manifest.packetization.grouping == "contiguous"
    return (decode_stream if is_valid else _subprocess.decode_in_fresh_process)(stream)
