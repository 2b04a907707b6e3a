"""Implementation of `splatwire convert`: runs `encode`, `decode` or `export` for each input, by its format."""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from splatwire.bitstream import read_stream
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.cli import _run_decode, _run_encode, _run_export
from splatwire.cli._files import (
    STANDARD,
    check_folder,
    check_inputs,
    input_path,
    output_folder,
    prepared_output,
    refuse_own_input,
)
from splatwire.cli._input_warnings import DAMAGED
from splatwire.cli._output import Reporter, print_json, print_summary, progress_bars
from splatwire.cli._processes import OWN_PROGRAM, Processes
from splatwire.cli.convert import Convert
from splatwire.cli.decode import Decode
from splatwire.cli.encode import Encode
from splatwire.cli.export import Export
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.concealment import create_concealer
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.files.kinds import STREAMS, file_kind
from splatwire.files.names import real_path
from splatwire.files.scene_formats import FORMATS
from splatwire.io import drawable_scene
from splatwire.io.formats import format_for
from splatwire.io.formats.content import FileContent
from splatwire.io.formats.dispatch import format_named, warn_of_background
from splatwire.lod.sog_levels import write_sog_levels
from splatwire.lod.tileset import TilesetReport, write_tileset
from splatwire.sequence import frame_writer
from splatwire.sequence.frame_writer import write_frame_files
from splatwire.sequence.frames import is_sequence, open_sequence
from splatwire.sequence.options import FRAME_RATE
from splatwire.sequence.sequence_files import (
    SEQUENCE_FORMATS,
    SequenceFormat,
    contents_of_sequence,
    contents_of_stream,
    sequence_format_for,
)

STREAM = FILE_SUFFIX.removeprefix(".")
"""Name of the stream format in `--to`."""
TILES, SOG_LEVELS = "3dtiles", "streamed.sog"
"""Names of 3D Tiles and of streamed SOG in `--to`: folders with levels of detail of a still scene."""
MAX_JOBS = 256
"""Maximum number of processes at the same time."""


@dataclass(frozen=True)
class Conversion:
    """Conversion job: input path, output path and output format.

    Attributes:
        source: Path of the input, or `-` for standard input.
        output: Path of the output, or `-` for standard output.
        form: Name of the output format: `swz`, `3dtiles`, `streamed.sog`, or a writable format of explicit Gaussians.
    """

    source: str
    output: str
    form: str


def run(command: Convert) -> None:
    """Runs `splatwire convert`: converts files to another format."""
    if not 1 <= command.jobs <= MAX_JOBS:
        raise InvalidValueError(f"--jobs is from 1 to {MAX_JOBS}, {command.jobs} is not")
    form = None if command.to is None else _checked_form(command.to)
    if command.output is not None and form is not None:
        _convert_inputs(command, form)
        return
    sources = command.sources if command.output is None else (*command.sources, command.output)
    if len(sources) != 2:
        raise InvalidValueError(
            "one input and one output are converted, as in `convert IN OUT`; several inputs need --to FORMAT -o FOLDER"
        )
    source, output = sources
    check_inputs(*([] if source == STANDARD else [Path(source)]))
    convert(Conversion(source, output, form or _form_of_name(output)), command)


def convert(chosen: Conversion, command: Convert) -> None:
    """Converts one input with the subcommand for the input's format, and prints the result.

    Args:
        chosen: The input, the output and its format.
        command: Options of `splatwire convert`.

    Raises:
        SplatwireError: If the input cannot be read or the output cannot be written.
    """
    refuse_own_input(chosen.output, chosen.source)
    with input_path(chosen.source) as path:
        source, kind = str(path), file_kind(path)
        if chosen.form in (TILES, SOG_LEVELS):
            _convert_to_levels(path, chosen, as_json=command.json)
        elif chosen.form == STREAM:
            _run_encode.run(Encode(source, chosen.output, json=command.json))
        elif _is_timed(path) and (form := sequence_format_for(chosen.output)) is not None:
            _convert_sequence(path, chosen, form, as_json=command.json)
        elif _is_timed(path) and Path(chosen.output).suffix:
            raise InvalidValueError(
                f"{chosen.output}: the frames of a clip are written to a folder, whose name has no suffix, with --to "
                f"{chosen.form.replace('.', '-')}; `decode --frame` writes one frame"
            )
        elif kind in STREAMS and _is_timed(path):
            suffix = format_named(chosen.form).suffix
            options: dict[str, Any] = {"accept_damage": command.accept_damage, "json": command.json}
            _run_decode.run(Decode(source, chosen.output, format=suffix.removeprefix("."), **options))
        elif sequence_format_for(f"x.{chosen.form}") is not None and chosen.form not in _writable():
            raise InvalidValueError(f"{chosen.source} is a still scene; .{chosen.form} files are for clips")
        elif is_sequence(path):
            _convert_frames(path, chosen, as_json=command.json)
        else:
            _run_export.run(Export(chosen.form.replace(".", "-"), source, Path(chosen.output), json=command.json))


def _convert_frames(path: Path, chosen: Conversion, *, as_json: bool) -> None:
    """Writes the frames of a sequence as files in another format."""
    started, suffix = time.perf_counter(), format_named(chosen.form).suffix
    with progress_bars() as report, output_folder(chosen.output) as folder:
        count = write_frame_files(open_sequence(path), folder, suffix, report)
    seconds = time.perf_counter() - started
    if as_json:
        print_json({"output": chosen.output, "num_frames": count, "seconds": seconds})
    else:
        print_summary(f"{count:,} frames, {seconds:.1f} s -> {chosen.output}")


def _convert_to_levels(path: Path, chosen: Conversion, *, as_json: bool) -> None:
    """Writes the levels of detail of a still scene as 3D Tiles or as streamed SOG into a new folder."""
    started = time.perf_counter()
    if _is_timed(path):
        raise InvalidValueError(
            f"{chosen.source}: {chosen.form} is for still scenes; `decode --frame` writes one frame"
        )
    scene = drawable_scene(path, create_concealer("drop"))[0]
    write = write_tileset if chosen.form == TILES else write_sog_levels
    with progress_bars() as report, output_folder(chosen.output) as folder:
        written = write(scene, folder, progress=lambda share: report("writing levels", share))
    seconds = time.perf_counter() - started
    if as_json:
        print_json({"output": chosen.output, **asdict(written), "seconds": seconds})
        return
    if isinstance(written, TilesetReport):
        where = "on the Earth" if written.geocentric else "without geographic place"
        text = f"{written.num_tiles:,} tiles of {written.num_levels} levels, {where}"
    else:
        text = f"{written.num_chunks:,} chunks of {written.num_levels} levels"
    size = f"{written.num_bytes:,} bytes, {seconds:.1f} s"
    print_summary(f"{written.num_gaussians:,} Gaussians in {text}, {size} -> {chosen.output}")


def _convert_sequence(path: Path, chosen: Conversion, sequence_format: SequenceFormat, *, as_json: bool) -> None:
    """Writes the frames of a sequence to one file."""
    started = time.perf_counter()
    output = prepared_output(Path(chosen.output))
    with progress_bars() as report:
        if file_kind(path) in STREAMS:
            stream = read_stream(path)[0]
            num_frames = open_side_info(stream.manifest, stream.side_info).timeline.num_frames
            if num_frames > frame_writer.MAX_FILES:
                raise InvalidValueError(
                    f"{chosen.source}: the clip of {stream.num_bytes:,} bytes has {num_frames:,} frames, and a file of "
                    f"this format gets {frame_writer.MAX_FILES:,} at most"
                )
            warn_of_background(output, BACKGROUND_SECTION.of_stream(stream))
            frames, count, rate = contents_of_stream(stream)
        else:
            sequence = open_sequence(path)
            frames, count = contents_of_sequence(sequence), sequence.num_frames
            rate = float(FRAME_RATE) if sequence.rate is None else sequence.rate
        num_frames = sequence_format.write(_reported(frames, count, report), output, rate)
    facts = {"num_frames": num_frames, "fps": rate, "num_bytes": output.stat().st_size}
    seconds = time.perf_counter() - started
    if as_json:
        print_json({"output": chosen.output, **facts, "seconds": seconds})
    else:
        print_summary(f"{num_frames:,} frames, {facts['num_bytes']:,} bytes, {seconds:.1f} s -> {chosen.output}")


def _reported(frames: Iterator[FileContent], count: int, report: Reporter) -> Iterator[FileContent]:
    for number, frame in enumerate(frames, 1):
        yield frame
        report("writing frames", number / count)


def _checked_form(name: str) -> str:
    """Returns the registered name of an output format, given its name in the option `--to`.

    Raises:
        UnknownNameError: If `convert` has no output format of that name.
    """
    name = name.replace("-", ".")
    if name in (STREAM, TILES, SOG_LEVELS, *(form.name for form in SEQUENCE_FORMATS)):
        return name
    try:
        return format_named(name).name
    except UnknownNameError:
        names = [TILES, SOG_LEVELS.replace(".", "-"), *_file_formats()]
        raise UnknownNameError("format to write", name, names) from None


def _writable() -> list[str]:
    return [form.name for form in FORMATS.all().values() if form.write is not None and form.scene_type is None]


def _file_formats() -> set[str]:
    """Returns the names of the formats that `convert` writes as one file, including formats of clips."""
    return {STREAM, *_writable(), *(form.name for form in SEQUENCE_FORMATS)}


def _form_of_name(output: str) -> str:
    """Returns the name of the format that the suffix of an output file selects.

    Raises:
        InvalidValueError: If the suffix is not that of a writable format.
    """
    if output.lower().endswith(FILE_SUFFIX):
        return STREAM
    try:
        form = sequence_format_for(output)
        return format_for(output).name if form is None else form.name
    except UnknownNameError:
        suffixes = ", ".join(f".{name}" for name in sorted(_file_formats()))
        raise InvalidValueError(
            f"{output}: its suffix names no format to write; known are {suffixes}; or give --to FORMAT"
        ) from None


def _convert_inputs(command: Convert, format_name: str) -> None:
    """Converts several inputs to outputs in a folder, and prints one common result.

    Raises:
        InvalidValueError: If no input is given, or two outputs would have one name.
        SystemExit: If an input could not be converted, with its exit status.
    """
    assert command.output is not None
    if not command.sources or STANDARD in command.sources:
        raise InvalidValueError("name the files to convert; standard input is converted by `convert - OUT`")
    folder = Path(command.output)
    check_folder(folder)
    chosen = [Conversion(name, str(folder / _output_name(name, format_name)), format_name) for name in command.sources]
    named: dict[str, str] = {}
    for each in chosen:
        other = named.setdefault(each.output, each.source)
        if other != each.source or command.sources.count(each.source) > 1:
            raise InvalidValueError(f"{other} and {each.source} would both be written to {each.output}: rename one")
    folder.mkdir(exist_ok=True)
    started, results = time.perf_counter(), list[dict[str, Any]]()
    processes = Processes()
    with progress_bars() as report, ThreadPoolExecutor(command.jobs) as pool:
        report("converting", 0.0)
        try:
            for result in pool.map(lambda each: _in_process(processes, each, command.accept_damage), chosen):
                results.append(result)
                for line in result.pop("messages"):
                    print(line, file=sys.stderr)
                report("converting", len(results) / len(chosen))
        except BaseException:  # also a signal: the pool would wait for all conversions
            processes.end()
            raise
    failed = [result for result in results if result["status"]]
    if command.json:
        print_json({"converted": results, "num_failed": len(failed), "seconds": time.perf_counter() - started})
    else:
        for result in results:
            size = "failed" if result["num_bytes"] is None else f"{result['num_bytes']:,} bytes"
            print_summary(f"{result['source']}: {size} -> {result['output']}")
        text = f"{len(results) - len(failed)} of {len(results)} converted"
        print_summary(f"{text}, {time.perf_counter() - started:.1f} s -> {command.output}")
    if failed:
        raise SystemExit(DAMAGED if all(result["status"] == DAMAGED for result in failed) else 2)


def _output_name(source: str, format_name: str) -> str:
    """Returns the file name of an output: name of the input with the suffix of the output format."""
    # Outputs that are folders, such as frames, have no suffix.
    path = real_path(Path(source))
    of_sequences = (suffix for file_format in SEQUENCE_FORMATS for suffix in file_format.suffixes)
    suffixes = sorted(
        (FILE_SUFFIX, *of_sequences, *(file_format.suffix for file_format in FORMATS.all().values())),
        key=len,
        reverse=True,
    )
    old_suffix = next((suffix for suffix in suffixes if path.name.lower().endswith(suffix)), path.suffix)
    stem = path.name if path.is_dir() else path.name[: len(path.name) - len(old_suffix)]
    if format_name in (STREAM, TILES, SOG_LEVELS):
        return f"{stem}{FILE_SUFFIX}" if format_name == STREAM else stem
    if path.exists() and _is_timed(path):
        return stem if sequence_format_for(f"x.{format_name}") is None else f"{stem}.{format_name}"
    return f"{stem}{format_named(format_name).suffix}"


def _is_timed(path: Path) -> bool:
    """True if a path contains a clip (moving Gaussians): a stream of a clip, a folder of frames or a `.splatv` file."""
    return read_stream(path)[0].manifest.schema.timed if file_kind(path) in STREAMS else is_sequence(path)


def _in_process(processes: Processes, chosen: Conversion, accept_damage: bool) -> dict[str, Any]:
    """Converts one of several inputs in a separate process, so that an error does not end the other conversions.

    Args:
        processes: The processes of all conversions.
        chosen: The conversion.
        accept_damage: True to convert also a stream with damaged bytes.

    Returns:
        Mapping with these keys:

        * `source` and `output`: the paths.
        * `status`: exit status of the process.
        * `num_bytes`: size of the output, bytes; None if nothing was written.
        * `error`: error message; None without an error.
        * `facts`: JSON object that the process printed; empty if nothing was written.
        * `messages`: messages of the process on standard error.
    """
    names = (chosen.source, chosen.output)
    source, output = (f"./{name}" if name.startswith("-") else name for name in names)  # no options
    words = [source, output, "--to", chosen.form.replace(".", "-"), "--json"]
    words += ["--accept-damage"] * accept_damage
    command = [*OWN_PROGRAM, "convert", *words]
    done = processes.run(command)
    messages = [line for line in done.stderr.splitlines() if line.startswith("splatwire: ") or done.returncode]
    if done.returncode < 0:
        messages.append(f"splatwire: error: {chosen.source}: the conversion was ended by signal {-done.returncode}")
    written = done.returncode in (0, DAMAGED)
    facts = json.loads(done.stdout) if written and done.stdout else {}
    return {
        "source": chosen.source,
        "output": chosen.output,
        "status": done.returncode,
        "num_bytes": _size(Path(chosen.output)) if written else None,
        "error": _error(messages) if done.returncode else None,
        "facts": facts,
        "messages": messages,
    }


def _error(messages: Sequence[str]) -> str:
    return next((line for line in messages if line.startswith("splatwire: error: ")), "".join(messages[-1:]))


def _size(path: Path) -> int:
    """Returns the size of a file, or of all files in a folder, bytes."""
    return (
        sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) if path.is_dir() else path.stat().st_size
    )
