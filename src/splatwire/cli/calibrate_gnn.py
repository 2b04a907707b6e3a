"""`splatwire calibrate gnn`: weights of the inpainting network for one scene, in the stream or in a file."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from splatwire.cli._calibration import complete_stream, write_with_section
from splatwire.cli._files import prepared_output
from splatwire.cli._output import JsonFlag, Reporter, print_json, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import BackendUnavailableError, InvalidValueError, UnknownNameError

if TYPE_CHECKING:
    from splatwire.calibrate.pseudo_loss import CalibrationData
    from splatwire.packets import SceneStream
    from splatwire.paper.calibration.config import CalibrationConfig
    from splatwire.paper.calibration.run import CalibrationResult

_RENDER_WIDTH = 200
_DEVICES = ("cpu", "cuda")


@dataclass(frozen=True)
class CalibrateGnn:
    """Train the inpainting network on one scene (--conceal gnn) and write its weights into the stream or a file."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Stream to write, with the weights in it (a name that ends in .swz), or weights file; a checkpoint goes to the
    same name with .checkpoint added."""
    preset: str = "paper"
    """paper (feature-focused), full (every attribute) or compact (few weights)."""
    bits: int | None = None
    """Bits per weight in a stream, 2 to 6; the last steps are taken with weights that are rounded so. Without it 4 in a
    stream and the preset's in a file."""
    iterations: int | None = None
    """Steps (for full and compact: at most); 15000 for paper, as there, and 2000 for the others where absent."""
    selected: bool | None = None
    """Whether held-out losses choose the best network, end the run early, and leave attributes that are no better to
    the interpolation; the paper has no such rule. No for paper, yes for the others where absent."""
    drop_rate: float = 0.2
    """Share of packets that is dropped in training."""
    render_weight: float = 0.0
    """Weight of the rendering loss; it needs --cameras, and the three options below are for it alone."""
    cameras: Path | None = None
    """Cameras file."""
    render_width: int | None = None
    """Width of its pictures, pixels; 200 where absent."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    precision: str | None = None
    """Of the weights in a file: float16 (where absent) or float32."""
    device: str = "cpu"
    """Where to train: cpu, or cuda (without the rendering loss)."""
    seed: int = 0
    """Seed of everything random."""
    resume: bool = False
    """Go on from the checkpoint beside the output."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.paper.calibration.calibrate import calibrate

        self._check()
        config, output = self._config(), prepared_output(self.output)
        checkpoint = output.with_name(output.name + ".checkpoint")
        with progress_bars() as show:
            stream, data = self._data(show)
            result = calibrate(
                data, config, checkpoint=checkpoint, resume=self.resume, device=self.device,
                progress=lambda step, loss: show("calibrating", step / config.iterations),
            )  # fmt: skip
        if self._embeds and not result.weights.improves:
            checkpoint.unlink(missing_ok=True)
            raise InvalidValueError(_refusal(result, output))
        sizes = self._write(stream, result, config.bits)
        checkpoint.unlink(missing_ok=True)
        report = self._report(result, config, sizes)
        print_json(report) if self.json else _print(report)

    @property
    def _embeds(self) -> bool:
        return self.output.suffix == ".swz"

    def _check(self) -> None:
        """Refuses options that would do nothing."""
        from splatwire.paper.gnn.weights import PRECISIONS

        if self.precision is not None and self.precision not in PRECISIONS:
            raise UnknownNameError("precision", self.precision, PRECISIONS)
        if self.precision is not None and self._embeds:
            raise InvalidValueError("--precision is for a file of weights: in a stream --bits says how exact they are")
        if self.device not in _DEVICES:
            raise UnknownNameError("device", self.device, _DEVICES)
        if self.device == "cuda":
            import torch

            if not torch.cuda.is_available():
                raise BackendUnavailableError("cuda", "torch finds no CUDA device; install its CUDA build, or use cpu")
            if self.render_weight:
                raise InvalidValueError("--render-weight is for --device cpu: that loss is drawn on the CPU")
        if not 0 <= self.render_weight < math.inf:
            raise InvalidValueError(f"--render-weight is 0 or more, not {self.render_weight:g}")
        if not self.render_weight:
            given = {"--cameras": self.cameras, "--render-width": self.render_width, "--background": self.background}
            idle = [name for name, value in given.items() if value is not None]
            if idle:
                raise InvalidValueError(f"{', '.join(idle)}: only for the rendering loss, and --render-weight is 0")

    def _config(self) -> "CalibrationConfig":
        from splatwire.paper.calibration.config import CALIBRATION_PRESETS
        from splatwire.paper.gnn.quantise import check_bits

        if self.preset not in CALIBRATION_PRESETS:
            raise UnknownNameError("calibration preset", self.preset, CALIBRATION_PRESETS)
        preset = CALIBRATION_PRESETS[self.preset]
        losses = dataclasses.replace(preset.losses, render=self.render_weight)
        bits = self.bits if self.bits is not None else preset.bits or (4 if self._embeds else 0)
        if self._embeds:
            check_bits(bits)
        return dataclasses.replace(
            preset, losses=losses, drop_rate=self.drop_rate, seed=self.seed, bits=bits,
            iterations=preset.iterations if self.iterations is None else self.iterations,
            selected=preset.selected if self.selected is None else self.selected,
        )  # fmt: skip

    def _data(self, show: Reporter) -> "tuple[SceneStream, CalibrationData]":
        from splatwire.calibrate.pseudo_loss import calibration_data
        from splatwire.codec import decode_stream, schema_named
        from splatwire.data import load_cameras
        from splatwire.model import Prior
        from splatwire.scene.origin import NO_ORIGIN

        cameras, background = None, chosen_background(self.background)
        if self.cameras is not None:
            cameras = load_cameras(self.cameras).relative_to(NO_ORIGIN)  # anchors have no origin
            cameras = cameras.scaled(min(1.0, (self.render_width or _RENDER_WIDTH) / cameras.width))
        stream = complete_stream(self.source, show)
        if Prior not in schema_named(stream.manifest.codec).offers:
            raise InvalidValueError(
                f"the network is for anchors, and this stream of {stream.manifest.elements} has none"
            )
        complete = decode_stream(stream, progress=lambda share: show("decoding", share))
        data = calibration_data(stream, complete, cameras)
        if background is not None:
            scene = dataclasses.replace(data.scene, background=background)
            data = dataclasses.replace(data, complete=dataclasses.replace(data.complete, scene=scene))
        return stream, data

    def _write(self, stream: "SceneStream", result: "CalibrationResult", bits: int) -> dict[str, int | float]:
        """Writes weights, alone or in the stream; returns what they cost."""
        from splatwire.codec import without_concealment
        from splatwire.paper.gnn.section import SECTION, write_section
        from splatwire.paper.gnn.weights import save_weights

        if self._embeds:
            bare = without_concealment(stream, SECTION)
            return write_with_section(bare, SECTION, write_section(result.weights, bits), self.output)
        save_weights(result.weights, self.output, precision=self.precision or "float16")
        size, total = self.output.stat().st_size, stream.num_bytes
        return {"num_bytes": size, "stream_bytes": total, "share_of_stream": size / total}

    def _report(
        self, result: "CalibrationResult", config: "CalibrationConfig", sizes: dict[str, int | float]
    ) -> dict[str, Any]:
        settings = result.weights.settings
        return {
            "output": str(self.output),
            "embedded": self._embeds,
            **sizes,
            "bits": config.bits,
            "iterations": result.iterations,
            "seconds": result.seconds,
            "interpolation": settings.interpolation,
            "errors": result.errors,
            "reference": result.reference,
            "attributes_taken": [n for n in result.errors if getattr(settings, f"{n}_threshold", 2.0) <= 1],
            "settings": dataclasses.asdict(settings),
        }


def _print(report: dict[str, Any]) -> None:
    print("error on held-out losses (RMSE over spread; mask: share of wrong entries)")
    for name, value in report["errors"].items():
        print(f"  {name:<8} {value:.4f}   {report['interpolation']} {report['reference'][name]:.4f}")
    print(f"taken from the network: {', '.join(report['attributes_taken']) or 'nothing'}")
    print(f"{report['iterations']:,} iterations, {report['seconds']:,.0f} s")
    where, share = "in" if report["embedded"] else "beside", 100 * report["share_of_stream"]
    total = f"{where} a stream of {report['stream_bytes']:,} ({share:.1f} %)"
    print(f"weights: {report['num_bytes']:,} bytes {total} -> {report['output']}")


def _refusal(result: "CalibrationResult", output: Path) -> str:
    interpolation = result.weights.settings.interpolation
    return (
        f"nothing improves on {interpolation} on held-out losses after {result.iterations} steps: no weights were put "
        f"into a stream, and {output} was not written"
    )
