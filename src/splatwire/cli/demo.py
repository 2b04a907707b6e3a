"""`splatwire demo`: the whole journey on the scene that comes with the package."""

import itertools
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._output import JsonFlag, Reporter, print_json, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.evaluate import Evaluation
    from splatwire.model import PartialScene
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras

_SCENE, _CAMERAS = "snowmiku.swz", "snowmiku_cameras.json"
_NETWORK = "snowmiku.gnn_section"
"""The GNN's weights for that scene as a stream carries them; the bundled stream carries its best concealer only."""
_LPIPS_VIEWS = 2
"""LPIPS takes seconds per picture on a CPU; on two views the demo still fits in two minutes."""
_NOTES = (
    "A compressed scene was split into independently decodable packets, some of them were lost, a fresh process "
    "decoded what had arrived, each concealer dealt with the gaps, and the CPU renderer drew the test views.",
    "The reference pictures are the lossless scene's own renders, not photos: the numbers say what the losses cost. "
    "The row contiguous drop is the same scene with packets of neighbouring anchors; all others use stratified lanes.",
)


@dataclass(frozen=True)
class Demo:
    """Lose 20 % of a real scene's packets, conceal, draw, score, and write a report."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("splatwire-demo")
    """Folder for the report."""
    loss: str = "bernoulli:0.2"
    """What is lost: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit is a .pak."""
    seed: int = 0
    """Seed of the losses."""
    stream: Path | None = None
    """Another complete stream instead of the bundled one; needs --cameras."""
    cameras: Path | None = None
    """Cameras file of that stream."""
    views: int | None = None
    """Most views, spread evenly; all where absent."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.evaluate import write_report

        started = time.perf_counter()
        with progress_bars() as show, tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
            result = self.evaluation(Path(folder), show)
            seconds = time.perf_counter() - started
            title = f"splatwire demo: {self._name} under {result.protocol.loss.name}"
            report = write_report(result, self.output, title=title, notes=_NOTES, extra={"demo_seconds": seconds})
        if self.json:
            print_json({**result.to_json(), "report": str(report), "demo_seconds": seconds})
            return
        from splatwire.cli._table import print_rows

        print_rows(result.rows(), title, lpips_note=result.lpips_note)
        print(f"PSNR is against the lossless scene's own renders. {seconds:.0f} s in all.")
        print(f"report: {report}")

    @property
    def _name(self) -> str:
        return "snowmiku" if self.stream is None else self.stream.stem

    def evaluation(self, folder: Path, show: Reporter) -> "Evaluation":
        """Makes the journey.

        Args:
            folder: For temporary files.
            show: Progress.
        """
        from splatwire.channel import parse_loss
        from splatwire.cli.evaluate import encode_contiguous
        from splatwire.codec import decode_stream
        from splatwire.conceal import concealer_names
        from splatwire.evaluate import Protocol, concealment_methods, evaluate_streams, rendered_views
        from splatwire.evaluate.views import spread
        from splatwire.metrics import find_lpips
        from splatwire.packets.sections import split_sections

        loss, lpips, background = parse_loss(self.loss), find_lpips(), chosen_background(self.background)
        stream, cameras = self._input()
        cameras = cameras.select(spread(cameras.num_views, self.views))
        methods = concealment_methods(concealer_names(split_sections(stream.side_info)[1]), contiguous=True)
        protocol = Protocol(methods, loss, (self.seed,), lpips_views=_LPIPS_VIEWS)
        scene = decode_stream(stream, progress=lambda share: show("decoding the complete scene", share)).scene
        contiguous = encode_contiguous(scene, stream, lambda share: show("encoding contiguous packets", share))
        views = rendered_views(
            scene, cameras, folder, background=background,
            progress=lambda share: show("drawing the reference pictures", share),
        )  # fmt: skip
        return evaluate_streams(
            protocol,
            {"stream": stream, "contiguous": contiguous},
            views,
            lpips=lpips,
            decode=_first_in_fresh_process(),
            progress=lambda method, share: show(f"drawing and scoring '{method}'", share),
        )

    def _input(self) -> "tuple[SceneStream, Cameras]":
        from splatwire.codec import add_concealment
        from splatwire.data import load_cameras
        from splatwire.packets import read_stream

        if (self.stream is None) != (self.cameras is None):
            raise InvalidValueError("give --stream and --cameras together")
        if self.stream is not None and self.cameras is not None:
            return read_stream(self.stream)[0], load_cameras(self.cameras)
        assets = Path(str(resources.files("splatwire").joinpath("assets")))
        stream = add_concealment(read_stream(assets / _SCENE)[0], "gnn", (assets / _NETWORK).read_bytes())
        return stream, load_cameras(assets / _CAMERAS)


def _first_in_fresh_process() -> "Callable[[SceneStream], PartialScene]":
    """The stream that the concealers share is decoded in a fresh process, the others here: that saves their start."""
    from splatwire.cli import _fresh
    from splatwire.codec import decode_stream

    calls = itertools.count()
    return lambda stream: (decode_stream if next(calls) else _fresh.decode_in_fresh_process)(stream)
