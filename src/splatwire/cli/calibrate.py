"""`splatwire calibrate`: weights of the GNN concealer, a sketch, or a preview, for one scene."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import is_stream
from splatwire.cli._output import JsonFlag, Reporter, print_json, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.cli.calibrate_preview import calibrate_preview
from splatwire.cli.calibrate_sketch import calibrate_sketch
from splatwire.errors import InvalidValueError, UnknownNameError

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.train.calibrate_gnn import (
        CalibrationConfig,
        CalibrationData,
        CalibrationProgress,
        CalibrationResult,
    )


METHODS = ("gnn", "sketch", "preview")


@dataclass(frozen=True)
class Calibrate:
    """Calibrate a concealer or a preview on one scene and put it into the stream (a GNN's weights also into a file)."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Stream to write, with the weights in it (a name that ends in .swz), or weights file; a checkpoint goes to the
    same name with .checkpoint added."""
    method: str = "gnn"
    """gnn (a network); sketch: coarse copies of the anchors that matter most in the picture (--conceal sketch); or
    preview: a hundred Gaussians that a receiver has to look at before anything else has arrived."""
    preset: str = "paper"
    """paper (feature-focused), full (every attribute) or compact (few weights)."""
    bits: int | None = None
    """Bits per weight in a stream, 2 to 6; the last steps are taken with weights that are rounded so. Without it 4 in a
    stream and the preset's in a file."""
    iterations: int = 2000
    """Most steps; the paper's are 15000 to 20000."""
    drop_rate: float = 0.2
    """Share of packets that is dropped in training."""
    render_weight: float = 0.0
    """Weight of the rendering loss; needs --cameras."""
    cameras: Path | None = None
    """Cameras file for the rendering loss, or for a sketch or a preview without photos."""
    data: Path | None = None
    """Posed photos for a sketch or a preview, of which the training views are used; a sphere of views without these and
    cameras."""
    share: float = 0.04
    """Bytes of a sketch over those of the stream."""
    render_width: int = 200
    """Width of its pictures, pixels."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    precision: str = "float16"
    """Of the weights in a file: float16 or float32."""
    seed: int = 0
    """Seed of everything random."""
    resume: bool = False
    """Go on from the checkpoint beside the output."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        if self.method not in METHODS:
            raise UnknownNameError("calibration method", self.method, METHODS)
        if self.method != "gnn":
            (calibrate_sketch if self.method == "sketch" else calibrate_preview)(self)
            return
        from splatwire.conceal.gnn.weights import PRECISIONS, save_weights
        from splatwire.train.calibrate_gnn import calibrate

        if self.precision not in PRECISIONS:
            raise UnknownNameError("precision", self.precision, PRECISIONS)
        config, background = self._config(), chosen_background(self.background)
        checkpoint = self.output.with_name(self.output.name + ".checkpoint")
        with progress_bars() as show:
            stream, data = self._data(show)
            if background is not None:
                data = dataclasses.replace(data, scene=dataclasses.replace(data.scene, background=background))
            self.output.parent.mkdir(parents=True, exist_ok=True)

            def told(now: "CalibrationProgress") -> None:
                show("calibrating", now.iteration / now.iterations)

            result = calibrate(data, config, checkpoint=checkpoint, resume=self.resume, progress=told)
        if self._embeds and not result.weights.improves:
            checkpoint.unlink(missing_ok=True)
            raise InvalidValueError(_refusal(result, self.output))
        if self._embeds:
            size, total = self._embed(stream, result, config.bits)
        else:
            save_weights(result.weights, self.output, precision=self.precision)
            size, total = self.output.stat().st_size, stream.num_bytes
        checkpoint.unlink(missing_ok=True)
        self._report(result, config, size, total)

    @property
    def _embeds(self) -> bool:
        return self.output.suffix == ".swz"

    def _embed(self, stream: "SceneStream", result: "CalibrationResult", bits: int) -> tuple[int, int]:
        """Writes the stream with the weights in it; returns their bytes and the bytes of all."""
        from splatwire.codec import add_concealment, without_concealment
        from splatwire.conceal.gnn.section import SECTION, write_section
        from splatwire.packets import write_stream

        bare = without_concealment(stream, SECTION)
        richer = add_concealment(bare, SECTION, write_section(result.weights, bits))
        write_stream(richer, self.output)
        return richer.num_bytes - bare.num_bytes, richer.num_bytes

    def _report(self, result: "CalibrationResult", config: "CalibrationConfig", size: int, total: int) -> None:
        settings = result.weights.settings
        taken = [name for name in result.errors if getattr(settings, f"{name}_threshold", 2.0) <= 1]
        if self.json:
            print_json(
                {
                    "output": str(self.output),
                    "num_bytes": size,
                    "embedded": self._embeds,
                    "stream_bytes": total,
                    "share_of_stream": size / total,
                    "bits": config.bits,
                    "iterations": result.iterations,
                    "seconds": result.seconds,
                    "interpolation": config.settings.interpolation,
                    "errors": result.errors,
                    "reference": result.reference,
                    "attributes_taken": taken,
                    "settings": dataclasses.asdict(settings),
                }
            )
            return
        print("error on held-out losses (RMSE over spread; mask: share of wrong entries)")
        for name, value in result.errors.items():
            print(f"  {name:<8} {value:.4f}   {settings.interpolation} {result.reference[name]:.4f}")
        print(f"taken from the network: {', '.join(taken) or 'nothing'}")
        where = f"in a stream of {total:,}" if self._embeds else f"beside a stream of {total:,}"
        print(f"{result.iterations:,} iterations, {result.seconds:,.0f} s")
        print(f"weights: {size:,} bytes {where} ({100 * size / total:.1f} %) -> {self.output}")

    def _config(self) -> "CalibrationConfig":
        from splatwire.conceal.gnn.quantise import check_bits
        from splatwire.train.calibrate_gnn import CALIBRATION_PRESETS

        if self.preset not in CALIBRATION_PRESETS:
            raise UnknownNameError("calibration preset", self.preset, CALIBRATION_PRESETS)
        preset = CALIBRATION_PRESETS[self.preset]
        losses = dataclasses.replace(preset.losses, render=self.render_weight)
        bits = self.bits if self.bits is not None else preset.bits or (4 if self._embeds else 0)
        if self._embeds or bits:
            check_bits(bits)
        return dataclasses.replace(
            preset, losses=losses, iterations=self.iterations, drop_rate=self.drop_rate, seed=self.seed, bits=bits
        )

    def _data(self, show: Reporter) -> "tuple[SceneStream, CalibrationData]":
        from splatwire.codec import decode_stream, encode_scene
        from splatwire.data import load_cameras
        from splatwire.model.scene_file import load_scene
        from splatwire.packets import PRESETS, read_stream
        from splatwire.train.calibrate_gnn import calibration_data

        cameras = None
        if self.cameras is not None:
            cameras = load_cameras(self.cameras)
            cameras = cameras.scaled(min(1.0, self.render_width / cameras.width))
        if is_stream(self.source):
            stream, _ = read_stream(self.source)
        else:
            scene = load_scene(self.source)
            stream = encode_scene(scene, PRESETS["paper"], progress=lambda share: show("encoding", share))
        complete = decode_stream(stream, progress=lambda share: show("decoding", share))
        return stream, calibration_data(stream, complete, cameras)


def _refusal(result: "CalibrationResult", output: Path) -> str:
    interpolation = result.weights.settings.interpolation
    return (
        f"nothing improves on {interpolation} on held-out losses after {result.iterations} steps: no weights were put "
        f"into a stream, and {output} was not written"
    )
