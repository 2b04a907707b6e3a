"""`splatwire evaluate`: a stream or scene is scored, or a protocol file runs."""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from splatwire.cli._files import input_path, is_stream
from splatwire.cli._output import JsonFlag, Reporter, print_json, progress_bars
from splatwire.cli._scenes import BackgroundOption, background_of_file, chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.evaluate import Evaluation, Protocol, ReferenceViews
    from splatwire.packets import SceneStream
    from splatwire.scene.background import Background


@dataclass(frozen=True)
class Evaluate:
    """Score a stream or scene: lose packets, conceal, draw the test views and compare; or run a protocol file."""

    source: tyro.conf.Positional[str]
    """Stream (complete or with losses) or scene file (as it is; with --loss it is encoded first), - for standard
    input; or a protocol file (.toml), as in benchmarks/paper."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder: its test photos are the references, inside their masks where they have some."""
    reference: Path | None = None
    """Scene file, stream, 3DGS PLY or .splat file whose renders are the references, instead of photos."""
    cameras: Path | None = None
    """Cameras file for --reference; without it those of --data."""
    loss: str | None = None
    """What is lost: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit is a .pak.
    Without it the source is scored as it is."""
    seeds: tuple[int, ...] = ()
    """One transmission per seed; all methods meet the same losses. Without it seed 0, or the protocol's."""
    conceal: tuple[str, ...] = ()
    """Concealers to compare; all where absent."""
    contiguous: bool = False
    """Add a row for packets of contiguous anchors, without concealment."""
    send_order: str = "interleaved"
    """interleaved or block."""
    renderer: str = "cpu"
    """Renderer: cpu, reference or gsplat."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent (or what the protocol
    says)."""
    views: int | None = None
    """Most views, spread evenly; all where absent."""
    lpips_views: int | None = None
    """Most views that LPIPS is computed on (slow on a CPU); all where absent."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for an HTML report with pictures, and for everything else that a protocol writes."""
    engine: str = "local"
    """Protocols: local (processes), ray (RAY_ADDRESS or a local cluster) or slurm."""
    workers: int | None = None
    """Protocols: workers at a time; one per processor where absent."""
    store: Path | None = None
    """Protocols: folder of finished work, OUTPUT/store where absent; what is there is not computed again."""
    data_root: Path | None = None
    """Protocols: value of ${SPLATWIRE_DATA} in their paths."""
    scene: str | None = None
    """Protocols: a stream, scene file, HAC++ folder, or the word bundled, instead of the protocol's scenes."""
    photos: Path | None = None
    """Protocols: dataset folder of --scene; without it --cameras, and the scene's own renders as references."""
    weights: Path | None = None
    """Protocols: calibrated GNN weights of --scene."""
    scene_name: str | None = None
    """Protocols: what --scene is called."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        if self.source.endswith(".toml"):
            from splatwire.cli._study import run_protocol

            run_protocol(self)
            return
        from splatwire.evaluate import write_report

        with progress_bars() as show, tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
            result = self.evaluation(Path(folder), show)
            title = f"{Path(self.source).name} {'as it is' if self.loss is None else 'under ' + self.loss}"
            title += ", inside the photos' masks" if result.masked else ""
            report = None if self.output is None else write_report(result, self.output, title=title)
        if self.json:
            print_json({**result.to_json(), "report": None if report is None else str(report)})
            return
        from splatwire.cli._table import print_rows

        print_rows(result.rows(), title, lpips_note=result.lpips_note)
        if report is not None:
            print(f"report: {report}")

    def evaluation(self, folder: Path, show: Reporter) -> "Evaluation":
        """Runs the comparison.

        Args:
            folder: For temporary files.
            show: Progress.
        """
        from splatwire.evaluate import evaluate_streams
        from splatwire.metrics import find_lpips
        from splatwire.packets.sections import split_sections

        self._protocol(complete=True)  # wrong names are told before any work
        lpips = find_lpips()
        chosen = chosen_background(self.background)
        with input_path(self.source) as path:
            background = background_of_file(path) if chosen is None else chosen
            views = self._views(folder, background, show).every(self.views)
            if self.loss is None and not is_stream(path):
                return self._scene_as_it_is(path, views, lpips, show)
            streams, seconds = self._streams(path, show)
        stream = streams["stream"]
        _, sections = split_sections(stream.side_info)
        protocol = self._protocol(complete=len(stream.packets) == stream.manifest.num_packets, sections=tuple(sections))
        result = evaluate_streams(protocol, streams, views, lpips=lpips, progress=show)
        return with_encode_seconds(result, seconds)

    def _scene_as_it_is(self, path: Path, views: "ReferenceViews", lpips: Any, show: Reporter) -> "Evaluation":
        from splatwire.cli.inspect import tensor_bytes
        from splatwire.evaluate import Method, evaluate_scene
        from splatwire.model import PartialScene
        from splatwire.model.scene_file import load_scene_file

        scene, erasures = load_scene_file(path)
        sections = tuple(scene.concealment) if isinstance(scene, PartialScene) else ()
        protocol = self._protocol(complete=erasures is None or erasures.num_lost == 0, sections=sections)
        if not isinstance(scene, PartialScene):
            lost = erasures is not None and erasures.num_lost > 0
            protocol = replace(protocol, methods=(Method("as it is" if lost else "no loss", lossless=not lost),))
        return evaluate_scene(protocol, scene, erasures, tensor_bytes(path), views, lpips=lpips, progress=show)

    def _protocol(self, *, complete: bool, sections: tuple[str, ...] = ()) -> "Protocol":
        from splatwire.channel import parse_loss
        from splatwire.conceal import concealer_names, create_concealer
        from splatwire.evaluate import Method, Protocol, concealment_methods
        from splatwire.render import create_renderer

        concealers = self.conceal or concealer_names(sections)
        for name in concealers:
            create_concealer(name)
        create_renderer(self.renderer)
        loss = parse_loss(self.loss or "none")
        if self.loss is None and complete:
            methods: tuple[Method, ...] = (Method("no loss", lossless=True),)
        else:
            contiguous = self.contiguous and self.loss is not None
            methods = concealment_methods(tuple(concealers), complete=complete, contiguous=contiguous)
        return Protocol(
            methods,
            loss,
            self.seeds or (0,),
            send_order=self.send_order,
            renderer=self.renderer,
            lpips_views=self.lpips_views,
        )

    def _views(self, folder: Path, background: "Background", show: Reporter) -> "ReferenceViews":
        from splatwire.data import open_dataset
        from splatwire.evaluate import photo_views, rendered_views

        if self.reference is None:
            if self.data is None or self.cameras is not None:
                raise InvalidValueError("give --data FOLDER, or --reference SCENE with --cameras FILE or --data FOLDER")
            return photo_views(open_dataset(self.data, split="test", background=background))
        from splatwire.cli._scenes import load_picturable
        from splatwire.cli.render import find_cameras
        from splatwire.evaluate.views import spread

        cameras = find_cameras(self.cameras, self.data)
        cameras = cameras.select(spread(cameras.num_views, self.views))
        scene, _ = load_picturable(self.reference, "drop")
        return rendered_views(
            scene, cameras, folder, renderer=self.renderer, background=background,
            progress=lambda share: show("drawing references", share),
        )  # fmt: skip

    def _streams(self, path: Path, show: Reporter) -> "tuple[dict[str, SceneStream], dict[str, float]]":
        """The streams to compare, by name, and the seconds that encoding took."""
        from splatwire.codec import decode_stream, encode_scene
        from splatwire.packets import PRESETS, read_stream

        seconds: dict[str, float] = {}
        if is_stream(path):
            stream, _ = read_stream(path)
        else:
            from splatwire.model.scene_file import load_scene

            started = time.perf_counter()
            stream = encode_scene(load_scene(path), PRESETS["paper"], progress=lambda share: show("encoding", share))
            seconds["stream"] = time.perf_counter() - started
        streams = {"stream": stream}
        if self.contiguous and self.loss is not None:
            scene = decode_stream(stream).scene
            started = time.perf_counter()
            streams["contiguous"] = encode_contiguous(scene, stream, lambda share: show("encoding contiguous", share))
            seconds["contiguous"] = time.perf_counter() - started
        return streams, seconds


def encode_contiguous(scene: Any, stream: "SceneStream", progress: Any) -> "SceneStream":
    """Encodes the scene of a complete stream again, with packets of contiguous anchors.

    Raises:
        InvalidValueError: If the stream is not complete.
    """
    from splatwire.codec import encode_scene

    if len(stream.packets) != stream.manifest.num_packets:
        raise InvalidValueError("the comparison with contiguous packets needs a complete stream")
    return encode_scene(scene, replace(stream.manifest.packetization, grouping="contiguous"), progress=progress)


def with_encode_seconds(result: "Evaluation", seconds: Mapping[str, float]) -> "Evaluation":
    """Notes the seconds of encoding in every run of a stream that was encoded here."""
    if not seconds:
        return result
    runs = tuple(
        replace(run, seconds={"encode": seconds.get(run.method.stream, 0.0), **run.seconds}) for run in result.runs
    )
    return replace(result, runs=runs)
