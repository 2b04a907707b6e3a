"""`splatwire calibrate`: weights of the GNN concealer for one scene."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import is_stream
from splatwire.cli._output import JsonFlag, Reporter, print_json, progress_bars
from splatwire.errors import UnknownNameError

if TYPE_CHECKING:
    from splatwire.train.calibrate_gnn import CalibrationConfig, CalibrationData, CalibrationProgress


@dataclass(frozen=True)
class Calibrate:
    """Train the GNN concealer on one scene; use the result with --conceal gnn:WEIGHTS."""

    source: tyro.conf.Positional[Path]
    """Complete stream, or scene file (it is encoded first)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Weights file to write; a checkpoint goes to the same name with .checkpoint added."""
    preset: str = "paper"
    """paper (feature-focused), full (every attribute) or compact (few weights)."""
    iterations: int = 2000
    """Most steps; the paper's are 15000 to 20000."""
    drop_rate: float = 0.2
    """Share of packets that is dropped in training."""
    render_weight: float = 0.0
    """Weight of the rendering loss; needs --cameras."""
    cameras: Path | None = None
    """Cameras file for the rendering loss."""
    render_width: int = 200
    """Width of its pictures, pixels."""
    precision: str = "float16"
    """Of the weights in the file: float16 or float32."""
    seed: int = 0
    """Seed of everything random."""
    resume: bool = False
    """Go on from the checkpoint beside the output."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.conceal.gnn.weights import PRECISIONS, save_weights
        from splatwire.train.calibrate_gnn import calibrate

        if self.precision not in PRECISIONS:
            raise UnknownNameError("precision", self.precision, PRECISIONS)
        config = self._config()
        checkpoint = self.output.with_name(self.output.name + ".checkpoint")
        with progress_bars() as show:
            data = self._data(show)
            self.output.parent.mkdir(parents=True, exist_ok=True)

            def told(now: "CalibrationProgress") -> None:
                show("calibrating", now.iteration / now.iterations)

            result = calibrate(data, config, checkpoint=checkpoint, resume=self.resume, progress=told)
        save_weights(result.weights, self.output, precision=self.precision)
        checkpoint.unlink(missing_ok=True)
        size = self.output.stat().st_size
        if self.json:
            print_json(
                {
                    "output": str(self.output),
                    "num_bytes": size,
                    "iterations": result.iterations,
                    "seconds": result.seconds,
                    "interpolation": config.settings.interpolation,
                    "errors": result.errors,
                    "reference": result.reference,
                    "settings": dataclasses.asdict(result.weights.settings),
                }
            )
            return
        print("error on held-out losses (RMSE over spread; mask: share of wrong entries)")
        for name, value in result.errors.items():
            print(f"  {name:<8} {value:.4f}   {config.settings.interpolation} {result.reference[name]:.4f}")
        print(f"{result.iterations:,} iterations, {result.seconds:,.0f} s, {size:,} bytes -> {self.output}")

    def _config(self) -> "CalibrationConfig":
        from splatwire.train.calibrate_gnn import CALIBRATION_PRESETS

        if self.preset not in CALIBRATION_PRESETS:
            raise UnknownNameError("calibration preset", self.preset, CALIBRATION_PRESETS)
        preset = CALIBRATION_PRESETS[self.preset]
        losses = dataclasses.replace(preset.losses, render=self.render_weight)
        return dataclasses.replace(
            preset, losses=losses, iterations=self.iterations, drop_rate=self.drop_rate, seed=self.seed
        )

    def _data(self, show: Reporter) -> "CalibrationData":
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
        return calibration_data(stream, complete, cameras)
