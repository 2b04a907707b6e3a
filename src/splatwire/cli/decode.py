"""`splatwire decode`: what arrived of a stream becomes a scene file."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import input_path, output_path, read_report_json
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars, tell_lost_harmonics
from splatwire.cli._scenes import OutliersOption, chosen_outliers
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.packets import ReadReport, SceneStream


@dataclass(frozen=True)
class Decode:
    """Decode what arrived of a stream; nothing but its bytes is needed."""

    stream: tyro.conf.Positional[str]
    """Stream: a .swz file, a folder, or - for standard input."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write; for explicit Gaussians a .ply, .spz, .sog or .splat file; for a clip a folder."""
    conceal: str | None = None
    """Concealer that fills what was lost (drop, prior, idw, cari, grow, ...). Without it the gaps stay marked in the
    file, and render or evaluate conceal them; explicit Gaussians that were lost are left out. Of a clip drop, hold,
    extrapolate, neighbors or motion, which it is where absent."""
    frame: int | None = None
    """Of a clip: the one frame to write, to a file, or into a folder if the output's name has no ending."""
    max_frames: int | None = None
    """Of a clip: most frames that are written, a file each; 20000 where absent."""
    format: str | None = None
    """Of a clip: format of the files, ply (where absent), compressed.ply, spz, sog or splat."""
    outliers: OutliersOption = None
    """Gaussians whose far positions or extreme values would cost all others precision in an .spz, .sog or
    .compressed.ply: clamp (where absent) moves them to the end of the range of the others, prune leaves them out, keep
    writes them as they are."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.cli._clips import check_concealer
        from splatwire.codec import decode_stream
        from splatwire.conceal import create_concealer
        from splatwire.formats.kinds import writer_for
        from splatwire.model.scene_digest import scene_digest
        from splatwire.packets import read_stream
        from splatwire.scene_io import save_decoded

        if self.conceal is not None:
            check_concealer(self.conceal)
        with input_path(self.stream) as source:
            stream, report = read_stream(source)
        if stream.manifest.schema.timed:
            self._decode_clip(stream, report)
            return
        if (self.frame, self.format, self.max_frames) != (None, None, None):
            raise InvalidValueError(f"--frame, --max-frames and --format are for a clip, which {self.stream} is not")
        concealer = None if self.conceal is None else create_concealer(self.conceal)
        elements, explicit = stream.manifest.elements, stream.manifest.schema.explicit
        suffix = Path(self.output).suffix if explicit else ""
        if explicit:
            writer_for(self.output)  # a name that says no format is told before the work
        elif self.outliers is not None:
            raise InvalidValueError("--outliers is for explicit Gaussians")
        outliers = chosen_outliers(self.outliers, self.output)
        started = time.perf_counter()
        with progress_bars() as show, output_path(self.output, suffix=suffix, json=self.json) as path:
            partial = decode_stream(stream, progress=lambda share: show("decoding", share))
            decoded = time.perf_counter()
            written = save_decoded(partial, concealer, path, outliers=outliers)
        tell_lost_harmonics(written, self.output)
        count, num_lost = written.num_elements, partial.erasures.num_lost
        if self.json:
            print_json(
                {
                    "output": self.output,
                    f"num_{elements.lower()}": count,
                    "num_lost": num_lost,
                    "digest": scene_digest(written.elements),
                    "concealer": self.conceal,
                    "seconds": decoded - started,
                    "packets": read_report_json(report),
                }
            )
        else:
            text = f"{count - num_lost:,} of {count:,} {elements} arrived"
            print_summary(f"{text}, decoded in {decoded - started:.1f} s -> {self.output}", self.output)

    def _decode_clip(self, stream: "SceneStream", report: "ReadReport") -> None:
        """Decodes a clip, to a file a frame or to one file."""
        from splatwire.cli._clips import check_num_frames, output_folder, write_frames
        from splatwire.clips.concealers import DEFAULT
        from splatwire.formats.kinds import writer_for

        folder = self.frame is None or not Path(self.output).suffix
        if not folder and self.format is not None:
            raise InvalidValueError("with --frame the name of the file says its format")
        suffix = f".{(self.format or 'ply').lstrip('.')}" if folder else Path(self.output).suffix
        writer_for(f"x{suffix}" if folder else self.output)
        outliers = chosen_outliers(self.outliers, f"x{suffix}" if folder else self.output)
        if self.frame is None:
            check_num_frames(stream, self.max_frames, "--max-frames allows more, --frame writes one")
        started, method = time.perf_counter(), self.conceal or DEFAULT
        output = output_folder(self.output) if folder else output_path(self.output, suffix=suffix, json=self.json)
        with progress_bars() as show, output as path:
            facts = write_frames(stream, path, suffix, method, self.frame, show, outliers)
        seconds = time.perf_counter() - started
        if self.json:
            packets = read_report_json(report)
            print_json({"output": self.output, **facts, "concealer": method, "seconds": seconds, "packets": packets})
            return
        count, tracks = facts["num_frames"], facts["num_tracks"]
        text = f"{count} frame{'s' * (count != 1)} of {tracks:,} tracks, {report.num_missing:,} packets missing"
        print_summary(f"{text}, decoded in {seconds:.1f} s -> {self.output}", self.output)
