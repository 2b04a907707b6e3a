"""Simple evaluations of one stream or scene file: selection of the concealers, execution and report."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splatwire.anchors.appearance import scene_of
from splatwire.arguments import checked
from splatwire.bitstream import SceneStream, packetization_named
from splatwire.bitstream.sections import sections_of
from splatwire.codec import schema_named, schema_of
from splatwire.concealment import concealer_names
from splatwire.concealment.registry import why_unfit
from splatwire.errors import InvalidValueError
from splatwire.evaluation.study.curve import run_loss_curve
from splatwire.evaluation.study.definition import Row, SceneEntry, Study
from splatwire.evaluation.study.engines import InProcess
from splatwire.evaluation.study.input_files import InputFiles
from splatwire.evaluation.study.outputs import write_report
from splatwire.evaluation.study.plain import concealment_rows, plain_content
from splatwire.evaluation.study.references import Progress
from splatwire.evaluation.study.run import StudyResult, run_study
from splatwire.evaluation.study.store import MemoryStore
from splatwire.types.received_scene import ReceivedScene


@checked
def run_plain_study(
    study: Study,
    output: Path | None,
    progress: Progress,
    *,
    decode: Callable[[SceneStream], ReceivedScene] | None = None,
    links: Mapping[str, str] | None = None,
    files: InputFiles | None = None,
) -> tuple[StudyResult, dict[str, Any]]:
    """Evaluates one scene under one loss model in the current process; writes a report with a loss curve if requested.

    Args:
        study: The evaluation: one scene and one loss model.
        output: Folder of the report; None for no report.
        progress: Called with the name of the current task and its finished share, 0 to 1.
        decode: Decoder of received streams; None for the decoder of the codec.
        links: Paths of other reports, by title.
        files: Reader of the scene's files; None for a new one.

    Returns:
        The results; and the results as JSON values, with the path of the report.

    Raises:
        SplatwireError: If a task fails.
    """
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        store = MemoryStore(Path(folder), files or InputFiles())
        engine = InProcess(progress=progress) if decode is None else InProcess(decode, progress)
        result = run_study(study, store, engine, progress)
        content = plain_content(result)
        content["report"] = None
        if output is not None:
            curve = run_loss_curve(result, store, InProcess(progress=progress), progress)
            content["report"] = str(write_report(result, store, output, content, curve=curve, links=links))
    return result, content


@checked
def plain_rows(
    entry: SceneEntry, concealers: Sequence[str], files: InputFiles, *, lossy: bool, contiguous: bool = False
) -> tuple[Row, ...]:
    """Returns the table rows of an evaluation of one stream or scene file.

    Args:
        entry: The stream or scene file.
        concealers: Names of concealers; all that apply if empty.
        files: Reader of the scene's files.
        lossy: True if packets are lost; False to evaluate the source as it is.
        contiguous: True to add a row in which neighbouring elements share a packet, for comparison.

    Raises:
        InvalidValueError: If a named concealer cannot conceal losses of the stream or scene.
    """
    if entry.kind == "stream":
        stream = files.stream(entry.source).require_static(entry.source)
        manifest, packed = stream.manifest, stream.manifest.packetization
        sections, schema_name = sections_of(stream), manifest.schema_name
        complete = len(stream.packets) == manifest.num_packets
    else:
        loaded_scene = files.loaded_scene(entry.source)
        loaded, complete = loaded_scene.loaded, loaded_scene.num_lost == 0
        scene = scene_of(loaded)
        if not lossy and scene is loaded:
            name = "no loss" if complete else "as it is"
            return (Row(name, name, None, lossless=complete),)
        schema_name = schema_of(scene).name
        packed = packetization_named(None, schema_name, int(scene.drawable.sum()))
        sections = dict(loaded.sections) if isinstance(loaded, ReceivedScene) else {}
    provides = schema_named(schema_name).provides
    for name in concealers if lossy or not complete else ():
        if reason := why_unfit(name, provides, sections):
            usable = ", ".join(concealer_names(sections, provides))
            raise InvalidValueError(f"{entry.name}: {reason}; use {usable}")
    names = concealers or concealer_names(sections, provides)
    if not lossy:
        return concealment_rows(() if complete else names, complete=complete)
    return concealment_rows(
        names,
        None if entry.kind == "stream" else packed,
        complete=complete,
        contiguous=replace(packed, grouping="contiguous") if contiguous else None,
    )
