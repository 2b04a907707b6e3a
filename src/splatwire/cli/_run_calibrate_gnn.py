"""Implementation of `splatwire calibrate gnn`: trains the concealment network (GNN) for one scene.

The weights are stored in the stream as side information, or in a separate file.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any

from splatwire.bitstream import SceneStream
from splatwire.calibration.pseudo_loss import CalibrationData, calibration_data
from splatwire.cli._calibration import complete_stream, write_with_section
from splatwire.cli._files import prepared_output
from splatwire.cli._output import Reporter, print_json, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.cli.calibrate import CalibrateGnn
from splatwire.codec import decode_stream, schema_named, without_section
from splatwire.data import load_cameras
from splatwire.errors import BackendUnavailableError, InvalidValueError, UnknownNameError
from splatwire.neural.training.device import has_cuda
from splatwire.paper.calibration.calibrate import calibrate
from splatwire.paper.calibration.config import CALIBRATION_PRESETS, CalibrationConfig
from splatwire.paper.calibration.run import CalibrationResult
from splatwire.paper.gnn.quantise import check_bits
from splatwire.paper.gnn.section import SECTION, write_section
from splatwire.paper.gnn.weights import PRECISIONS, save_weights
from splatwire.types import Prior

_RENDER_WIDTH = 200
_DEVICES = ("cpu", "cuda")


def run(command: CalibrateGnn) -> None:
    """Runs `splatwire calibrate gnn`: trains the concealment network on one scene and writes its weights."""
    _check(command)
    config, output = _config(command), prepared_output(command.output)
    checkpoint = output.with_name(output.name + ".checkpoint")
    with progress_bars() as show:
        stream, data = _data(command, show)
        result = calibrate(
            data, config, checkpoint=checkpoint, resume=command.resume, device=command.device,
            progress=lambda step, loss: show("calibrating", step / config.iterations),
        )  # fmt: skip
    if _embeds(command) and not result.weights.is_used:
        checkpoint.unlink(missing_ok=True)
        raise InvalidValueError(_refusal(result, output))
    sizes = _write(command, stream, result, config.bits)
    checkpoint.unlink(missing_ok=True)
    report = _report(command, result, config, sizes)
    print_json(report) if command.json else _print(report)


def _embeds(command: CalibrateGnn) -> bool:
    return command.output.suffix == ".swz"


def _check(command: CalibrateGnn) -> None:
    """Checks the values of the options of `calibrate gnn`, and that they can be combined."""
    if command.precision is not None and command.precision not in PRECISIONS:
        raise UnknownNameError("precision", command.precision, PRECISIONS)
    if command.precision is not None and _embeds(command):
        raise InvalidValueError("--precision is for a file of weights; for a stream use --bits")
    if command.device not in _DEVICES:
        raise UnknownNameError("device", command.device, _DEVICES)
    if command.device == "cuda":
        if not has_cuda():
            raise BackendUnavailableError("cuda", "torch finds no CUDA device; install its CUDA build, or use cpu")
        if command.render_weight:
            raise InvalidValueError("--render-weight is for --device cpu: that loss is drawn on the CPU")
    if command.distill_weight is not None and not 0 <= command.distill_weight < math.inf:
        raise InvalidValueError(f"--distill-weight is 0 or more, not {command.distill_weight:g}")
    if not 0 <= command.render_weight < math.inf:
        raise InvalidValueError(f"--render-weight is 0 or more, not {command.render_weight:g}")
    if not command.render_weight:
        changed = {
            "--cameras": command.cameras,
            "--render-width": command.render_width,
            "--background": command.background,
        }
        idle = [name for name, value in changed.items() if value is not None]
        if idle:
            raise InvalidValueError(f"{', '.join(idle)}: only for the rendering loss, and --render-weight is 0")


def _config(command: CalibrateGnn) -> CalibrationConfig:
    if command.preset not in CALIBRATION_PRESETS:
        raise UnknownNameError("calibration preset", command.preset, CALIBRATION_PRESETS)
    preset = CALIBRATION_PRESETS[command.preset]
    distill = preset.losses.distill if command.distill_weight is None else command.distill_weight
    losses = dataclasses.replace(preset.losses, distill=distill, render=command.render_weight)
    bits = command.bits if command.bits is not None else preset.bits or (4 if _embeds(command) else 0)
    if _embeds(command):
        check_bits(bits)
    return dataclasses.replace(
        preset, losses=losses, drop_rate=command.drop_rate, seed=command.seed, bits=bits,
        iterations=preset.iterations if command.iterations is None else command.iterations,
        selected=preset.selected if command.selected is None else command.selected,
    )  # fmt: skip


def _data(command: CalibrateGnn, show: Reporter) -> tuple[SceneStream, CalibrationData]:
    cameras, background = None, chosen_background(command.background)
    if command.cameras is not None:
        cameras = load_cameras(command.cameras)
        cameras = cameras.scaled(min(1.0, (command.render_width or _RENDER_WIDTH) / cameras.width))
    stream = complete_stream(command.source, show)
    if Prior not in schema_named(stream.manifest.schema_name).provides:
        raise InvalidValueError(f"the network is for anchors, and this stream of {stream.manifest.elements} has none")
    complete = decode_stream(stream, progress=lambda share: show("decoding", share))
    data = calibration_data(stream, complete, cameras)
    if background is not None:
        scene = dataclasses.replace(data.scene, background=background)
        data = dataclasses.replace(data, complete=dataclasses.replace(data.complete, scene=scene))
    return stream, data


def _write(command: CalibrateGnn, stream: SceneStream, result: CalibrationResult, bits: int) -> dict[str, int | float]:
    """Writes the network weights to a separate file or into the stream.

    Args:
        command: Options of `splatwire calibrate gnn`.
        stream: The stream of the scene.
        result: The trained network.
        bits: Number of bits per weight in the stream.

    Returns:
        Mapping with the size of the weights in bytes, the size of the stream in bytes, and the ratio of these sizes.
    """
    if _embeds(command):
        bare = without_section(stream, SECTION)
        return write_with_section(bare, SECTION, write_section(result.weights, bits), command.output)
    save_weights(result.weights, command.output, precision=command.precision or "float16")
    size, total = command.output.stat().st_size, stream.num_bytes
    return {"num_bytes": size, "stream_bytes": total, "share_of_stream": size / total}


def _report(
    command: CalibrateGnn, result: CalibrationResult, config: CalibrationConfig, sizes: dict[str, int | float]
) -> dict[str, Any]:
    settings = result.weights.settings
    return {
        "output": str(command.output),
        "embedded": _embeds(command),
        **sizes,
        "bits": config.bits,
        "iterations": result.iterations,
        "seconds": result.seconds,
        "interpolation": settings.interpolation,
        "distill_weight": config.losses.distill,
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


def _refusal(result: CalibrationResult, output: Path) -> str:
    interpolation = result.weights.settings.interpolation
    return (
        f"nothing improves on {interpolation} on held-out losses after {result.iterations} steps: no weights were put "
        f"into a stream, and {output} was not written"
    )
