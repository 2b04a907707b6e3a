"""Implementation of `splatwire evaluate`: image quality of a stream or scene."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from splatwire.bitstream import SceneStream, is_stream
from splatwire.channel import parse_loss
from splatwire.cli._concealers import check_concealer
from splatwire.cli._files import check_folder, check_inputs, input_path
from splatwire.cli._output import print_facts, print_json, print_table, progress_bars, refuse_options
from splatwire.cli._scenes import chosen_background
from splatwire.cli._table import print_rows
from splatwire.cli._terminal import printable
from splatwire.cli.evaluate import Evaluate
from splatwire.concealment import create_concealer
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.errors import InvalidValueError
from splatwire.evaluation.sequence.report import HEADINGS, cells
from splatwire.evaluation.sequence.run import UNIT, evaluate_sequence, sequence_rows
from splatwire.evaluation.study import Loss, SceneEntry, Study, plain_rows, run_plain_study
from splatwire.evaluation.study.input_files import InputFiles
from splatwire.evaluation.walkthrough.delivery import Link
from splatwire.evaluation.walkthrough.run import evaluate_path, path_facts
from splatwire.files.kinds import opened
from splatwire.metrics.registry import METRICS
from splatwire.render import create_renderer
from splatwire.sequence import is_sequence

_FACTORS = {"k": 1e3, "M": 1e6, "G": 1e9}
_NOT_OF_SEQUENCES = ("data", "contiguous", "background", "lpips_views")
"""Options that apply only to static scenes."""
_NOT_WITH_PATH = ("data", "cameras", "conceal", "contiguous", "views", "lpips_views")
"""Options that cannot be combined with `--path`."""
_ONLY_WITH_PATH = ("rate", "delay", "seconds")
"""Options that require `--path`."""


def run(command: Evaluate) -> None:
    """Runs `splatwire evaluate`: measures the quality of a stream or scene."""
    link, files = _check(command), InputFiles()
    with input_path(command.source) as path:
        if link is not None:
            _evaluate_path(command, files.stream(path), link)
        elif is_stream(path) and (stream := files.stream(path)).manifest.schema.timed:
            _evaluate_sequence(command, stream)
        else:
            _evaluate_scene(command, path, files)


def _evaluate_path(command: Evaluate, stream: SceneStream, link: Link) -> None:
    assert command.path is not None
    assert command.reference is not None
    name = _title(command)
    with progress_bars() as show:
        content = evaluate_path(
            stream, command.path, link, command.reference, lossy=bool(command.loss), seconds=command.seconds,
            renderer=command.renderer, background=chosen_background(command.background), output=command.output,
            title=name, progress=show,
        )  # fmt: skip
    _print_result(command, content, lambda: print_facts([path_facts(content)], name))


def _evaluate_sequence(command: Evaluate, stream: SceneStream) -> None:
    refuse_options(command, _NOT_OF_SEQUENCES, "is for a still scene, not for a clip")
    if command.reference is None or not is_sequence(command.reference):
        raise InvalidValueError("a clip is compared with its source frames: give --reference FOLDER")
    for concealer in command.conceal:
        temporal_concealer(concealer)
    name = _title(command)
    rows = sequence_rows(stream, command.conceal, command.loss, command.seeds)
    with progress_bars() as show:
        content = evaluate_sequence(
            stream, command.reference, rows, cameras=command.cameras, views=command.views, renderer=command.renderer,
            output=command.output, title=name, progress=lambda share: show("comparing frames", share),
        )  # fmt: skip
    _print_result(command, content, lambda: _print_sequence(content, name))


def _print_sequence(content: dict[str, Any], title: str) -> None:
    """Prints the image quality of a sequence on standard output, one table row for each loss and concealer."""
    under = "".join(f" under {loss}" for loss in {row["loss"] for row in content["rows"]} - {None, "none"})
    later = ", from the second group on" if content["frames"] > content["group_frames"] else ""
    shown = [number for number, name in enumerate(HEADINGS) if name != "loss"]  # it is in the title
    rows = [[cells(row)[number] for number in shown] for row in content["rows"]]
    print_table([HEADINGS[number] for number in shown], rows, f"{title}{under}{later}")


def _evaluate_scene(command: Evaluate, path: Path, files: InputFiles) -> None:
    if command.reference is None and (command.data is None or command.cameras is not None):
        raise InvalidValueError("give --data FOLDER, or --reference SCENE (with --cameras FILE or --data FOLDER)")
    if command.cameras is not None and command.data is not None:
        raise InvalidValueError("give either --cameras FILE or --data FOLDER")
    for concealer in command.conceal:
        create_concealer(concealer)
    named = nullcontext() if command.reference is None else opened(command.reference)
    with progress_bars() as show, named as reference:
        study = _study(command, path, reference, files)
        result, content = run_plain_study(study, command.output, show, files=files)
    title, note = result.study.title, result.lpips_note
    _print_result(command, content, lambda: print_rows(content["rows"], title, lpips_note=note))


def _print_result(command: Evaluate, content: Mapping[str, Any], show: Callable[[], None]) -> None:
    """Prints the results as JSON or as a table, and the path of the report."""
    if command.json:
        print_json(content)
        return
    show()
    if content["report"] is not None:
        print(f"report: {content['report']}")


def _check(command: Evaluate) -> Link | None:
    """Checks the options of `splatwire evaluate` and parses the simulated network link, before files are read.

    Returns:
        The simulated network link for the camera path of `--path`; None without a path.

    Raises:
        InvalidValueError: If a required option or an input is missing, or an option has no effect with the others.
        UnknownNameError: If there is no such concealer or renderer.
    """
    if command.source.endswith(".toml"):
        raise InvalidValueError(
            f"{command.source} is a protocol, which `splatwire study {command.source} -o FOLDER` runs"
        )
    check_inputs(command.data, command.reference, command.cameras, command.path)
    link = _link(command)
    if command.output is not None:
        check_folder(command.output)
    if command.loss is None:
        for name in ("seeds", "contiguous"):
            if getattr(command, name):
                raise InvalidValueError(f"--{name} needs --loss: without it nothing is sent")
    for concealer in command.conceal:
        check_concealer(concealer)
    create_renderer(command.renderer)
    return link


def _title(command: Evaluate) -> str:
    """Returns the name of the source for titles; bytes of the name that are not UTF-8 are escaped."""
    return printable(Path(command.source).name)


def _link(command: Evaluate) -> Link | None:
    """Returns the simulated network link for a walk along a camera path (option `--path`); None without a path."""
    if command.path is None:
        refuse_options(command, _ONLY_WITH_PATH, "is for a walk through a scene with levels: give --path CAMERAS")
        return None
    refuse_options(command, _NOT_WITH_PATH, "means nothing together with --path")
    if command.reference is None:
        raise InvalidValueError("pictures along a path are compared with those of --reference SCENE")
    if len(command.seeds) > 1:
        raise InvalidValueError("--path takes one seed")
    if command.rate is None:
        raise InvalidValueError("--path needs the --rate of the link, such as 10M")
    loss = parse_loss(command.loss or "none", UNIT)
    delay = 0.02 if command.delay is None else command.delay / 1e3
    return Link(_parse_rate(command.rate), delay, loss, *command.seeds)


def _parse_rate(text: str) -> float:
    """Parses a bit rate with unit, for example `10M` or `800k`, and returns bits per second."""
    number, factor = (text[:-1], _FACTORS[text[-1]]) if text[-1:] in _FACTORS else (text, 1.0)
    try:
        return float(number) * factor
    except ValueError:
        raise InvalidValueError(f"--rate takes bits per second, such as 10M, 800k or 2.5e6, not {text!r:.40}") from None


def _study(command: Evaluate, path: Path, reference: Path | None, files: InputFiles) -> Study:
    """Returns the definition of the evaluation of a stream or scene file."""
    entry = SceneEntry(
        name=printable(Path(command.source).stem) if command.source != "-" else "standard input",
        source=path,
        kind="stream" if is_stream(path) else "scene",
        photos=command.data,
        cameras=command.cameras,
        reference=reference,
        background=chosen_background(command.background),
    )
    rows = plain_rows(entry, command.conceal, files, lossy=command.loss is not None, contiguous=command.contiguous)
    lossy = [row.key for row in rows if not row.lossless and row.label != "contiguous drop"]
    return Study(
        name=entry.name,
        title=f"{_title(command)} {'as it is' if command.loss is None else 'under ' + command.loss}",
        scenes=(entry,),
        rows=rows,
        losses=(Loss(command.loss or "none"),),
        seeds=command.seeds or (0,),
        baseline=lossy[0] if lossy else None,
        metrics=tuple(METRICS.all()),
        views=command.views,
        lpips_views=command.lpips_views,
        renderer=command.renderer,
    )
