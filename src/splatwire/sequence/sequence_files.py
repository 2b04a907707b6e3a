"""Reads and writes sequence files of other programs, each of which contains all frames of a sequence."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.concealment.temporal.concealers import DEFAULT
from splatwire.errors import InvalidValueError
from splatwire.files.kinds import FOURDGS, SPLAT4D, USD, Kind
from splatwire.files.scene_formats import FileFormat
from splatwire.io.formats.content import FileContent, relative_to_first
from splatwire.io.formats.dispatch import storable_properties
from splatwire.sequence.decoding import decode_frames
from splatwire.sequence.frames import Sequence


@dataclass(frozen=True)
class SequenceFormat:
    """A file format for sequences.

    Attributes:
        name: Name of the format in the command-line option `--to`.
        suffixes: File name suffixes; the first is the default.
        kind: Detected file type of such a file (`splatwire.files.kinds`).
        module: Name of the module in `splatwire.io.formats` that contains the writer.
        writer: Name of the function that writes a file, given frames, path and frames per second.
        write_options: As in `FileFormat`: names of scene properties that such a file can store, such as the origin.
    """

    name: str
    suffixes: tuple[str, ...]
    kind: Kind
    module: str
    writer: str
    write_options: frozenset[str] = frozenset()

    def write(self, frames: Iterable[FileContent], path: Path, rate: float) -> int:
        """Writes a sequence; returns the number of frames."""
        write: Callable[..., Any] = getattr(import_module(f"splatwire.io.formats.{self.module}"), self.writer)
        return int(write(self._checked(frames, path), path, rate))

    def _checked(self, frames: Iterable[FileContent], path: Path) -> Iterator[FileContent]:
        """Yields the frames relative to the origin of the first visible one. Logs what the file format cannot store."""
        form = FileFormat(self.name, "a sequence", write_options=self.write_options)
        for number, frame in enumerate(relative_to_first(frames)):
            if not number:
                storable_properties(
                    form, path, antialiased=frame.antialiased, origin=frame.origin, metadata=frame.metadata
                )
            yield frame


SEQUENCE_FORMATS = (
    SequenceFormat(
        "usd", (".usd", ".usdc", ".usda", ".usdz"), USD, "usd", "write_usd_frames", frozenset(("origin", "metadata"))
    ),
    SequenceFormat("4dgs", (".4dgs",), FOURDGS, "fourdgs_file", "write_fourdgs"),
    SequenceFormat("splat4d", (".splat4d",), SPLAT4D, "splat4d_file", "write_splat4d"),
)
"""Formats of written sequences, except streams."""


def sequence_format_for(path: str) -> SequenceFormat | None:
    """Returns the sequence file format that has the suffix of a file name; None if no format has it."""
    return next((form for form in SEQUENCE_FORMATS if path.lower().endswith(form.suffixes)), None)


def contents_of_sequence(sequence: Sequence) -> Iterator[FileContent]:
    """Yields the content of each frame for writing to a file: the visible Gaussians, and the metadata."""
    for frame in sequence.read():
        splats = frame.splats.select(frame.drawn)
        yield FileContent(splats, frame.origin, frame.antialiased, frame.metadata)


def contents_of_stream(stream: SceneStream) -> tuple[Iterator[FileContent], int, float]:
    """Decodes a stream of a sequence with the default concealer.

    Returns:
        The frames, their number, and frames per second.

    Raises:
        InvalidValueError: If the stream is not a sequence.
    """
    if not stream.manifest.schema.timed:
        raise InvalidValueError("the stream has no frames")
    sequence = decode_stream(stream).scene
    timeline = sequence.timeline
    frames = (
        FileContent(frame.scene.drawn(), sequence.origin, sequence.antialiased, sequence.metadata)
        for frame in decode_frames(sequence, DEFAULT)
    )
    return frames, timeline.num_frames, float(timeline.rate)
