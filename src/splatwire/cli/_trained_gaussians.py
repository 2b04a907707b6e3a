"""Implementation of `splatwire train --model gaussians`: trains explicit Gaussians from photos with known cameras."""

import dataclasses
import sys
from pathlib import Path
from typing import Any

from splatwire.bitstream import write_stream
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.cli._files import prepared_output
from splatwire.cli._options import quality_option
from splatwire.cli._output import print_json, print_summary, refuse_options
from splatwire.cli._scenes import chosen_background
from splatwire.cli._served_training import check_serving, served_training
from splatwire.cli._training import (
    DEFAULT_ITERATIONS,
    GAUSSIAN_RECIPE_OPTIONS,
    changed_options,
    check_same_photos,
    check_same_recipe,
    preset_of,
    preview_writer,
    stopped_early,
    training_data,
    training_display,
)
from splatwire.cli.train import Train
from splatwire.codec import encode_scene, with_section
from splatwire.codec.gaussians.quality import quality_of
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.codec.initial_view import initial_view_section
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.io import open_scene, save_scene
from splatwire.io.formats import format_for
from splatwire.neural.training import RunOptions
from splatwire.neural.training.checkpoint import record_to_json
from splatwire.neural.training.gaussians import (
    GaussianConfig,
    GaussianResult,
    load_gaussian_checkpoint,
    save_gaussian_checkpoint,
    train_gaussians,
)
from splatwire.neural.training.gaussians.config import GaussianRates, fine_tuning_iterations_for
from splatwire.neural.training.gaussians.initial import initial_gaussians
from splatwire.neural.training.gaussians.state import GaussianState
from splatwire.neural.training.initial import points_of
from splatwire.neural.training.presets import PRESETS
from splatwire.types import SplatScene
from splatwire.types.background import BLACK

GAUSSIAN_MODEL = "gaussians"
"""Value of `--model` for explicit Gaussians."""
_OF_ANCHORS = ("lmbda", "size", "voxel_size", "growth_interval", "refine", "loss_share")
"""Options that apply only to anchors."""


def check_gaussian_options(command: Train) -> None:
    """Checks the options of a training of explicit Gaussians.

    Raises:
        InvalidValueError: If an option applies only to anchors, or a value is not valid.
        UnknownNameError: If the file name has no suffix of a format of explicit Gaussians.
    """
    check_serving(command)
    refuse_options(command, _OF_ANCHORS, "is for anchors: the size of explicit Gaussians follows from --gaussians")
    if len(command.loss) > 1:
        raise InvalidValueError("--model gaussians takes one --loss")
    if not command.output.lower().endswith(FILE_SUFFIX):
        form = format_for(command.output)
        if form.scene_type not in (None, SplatScene):
            raise InvalidValueError(f"{command.output}: {form.description} does not hold explicit Gaussians")
    _config(command)


def run_gaussians(command: Train, device: str, device_name: str) -> None:
    """Trains explicit Gaussians, writes the result, and prints a summary.

    Args:
        command: Options of `splatwire train`.
        device: Name of the training device.
        device_name: Name of the device in messages.
    """
    output = prepared_output(Path(command.output))
    checkpoint = output.with_name(output.name + ".checkpoint")
    if command.resume:
        state, config = load_gaussian_checkpoint(checkpoint)
        check_same_recipe(changed_options(command), _config(command), config, GAUSSIAN_RECIPE_OPTIONS)
        train, test = training_data(command, config.test_views, config.background)
        check_same_photos(state.photo_size, train)
    else:
        state, config, train, test = _initial_training(command, device_name)
        save_gaussian_checkpoint(state, config, checkpoint)  # reports an unwritable checkpoint at once
    options = RunOptions(checkpoint, command.checkpoint_interval)
    with served_training(command, state.origin, config.background) as served:
        with training_display(
            preview_writer(command.preview), "fine-tuning with the rounding of the codec"
        ) as listener:
            listener = dataclasses.replace(listener, iterated=served.iterated)
            result = train_gaussians(
                train, test, config, state=state, options=options, listener=listener, device=device
            )
        if result.stopped:
            raise stopped_early(result.state.iteration, config.iterations, has_init=command.init is not None)
        num_bytes = _write(result.scene, train, output)
        served.finish(result.scene)
    _report(command, result, config, num_bytes)


def _write(scene: SplatScene, train: Dataset, output: Path) -> int | None:
    """Writes the trained scene to a file.

    Returns the size of the file in bytes if it is a stream (`.swz`), else None.

    Args:
        scene: The trained scene.
        train: Dataset with the training views; their cameras give a stream its initial view.
        output: Path of the output.
    """
    if not output.name.lower().endswith(FILE_SUFFIX):
        save_scene(scene, output)
        return None
    stream = with_section(
        encode_scene(scene), INITIAL_VIEW, initial_view_section(train.cameras.relative_to(scene.origin))
    )
    write_stream(stream, output)
    return stream.num_bytes


def _initial_training(
    command: Train, device_name: str
) -> tuple[GaussianState, GaussianConfig, Dataset, Dataset | None]:
    """Prepares a new training.

    Args:
        command: Options of `splatwire train`.
        device_name: Name of the training device, for messages.

    Returns:
        Initial state, configuration, dataset of the training views, and dataset of the test views. The last is None if
        there are no test views.
    """
    config = _config(command)
    start = None if command.init is None else open_scene(command.init)
    train, test = training_data(command, config.test_views, config.background)
    if start is not None:
        train = dataclasses.replace(train, points=points_of(start))
    chosen = " (chosen by the data)" if command.preset == "auto" else ""
    print(
        f"preset {config.preset}{chosen}, {config.gaussians:,} Gaussians, {config.iterations:,} iterations and "
        f"{config.fine_tuning_iterations:,} more with the rounding of the codec, on the {device_name}",
        file=sys.stderr,
    )
    if train.points is None or not train.points.num_points:
        print("the dataset has no points: the first Gaussians get random positions", file=sys.stderr)
    return initial_gaussians(train, config), config, train, test


def _config(command: Train) -> GaussianConfig:
    preset = preset_of(command)
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, PRESETS)
    iterations = DEFAULT_ITERATIONS if command.iterations is None else command.iterations
    chosen: dict[str, Any] = {
        name: value for name in ("gaussians", "degree") if (value := getattr(command, name)) is not None
    }
    return GaussianConfig(
        preset=preset,
        iterations=iterations,
        fine_tuning_iterations=fine_tuning_iterations_for(max(iterations, 0)),
        rates=GaussianRates().for_length(max(iterations, 1)),
        quality=quality_of(quality_option(command.quality or "default")),
        packet_loss=command.loss[0] if command.loss else None,
        background=chosen_background(command.background) or BLACK,
        test_views=PRESETS[preset].test_views,
        seed=command.seed,
        **chosen,
    )


def _report(command: Train, result: GaussianResult, config: GaussianConfig, num_bytes: int | None) -> None:
    test, scene = result.test, result.scene
    if command.json:
        print_json(
            {
                "output": command.output,
                "iterations": result.state.iteration,
                "num_gaussians": scene.num_gaussians,
                "degree": scene.splats.degree,
                "test_psnr": test.psnr if test else None,
                "test_ssim": test.ssim if test else None,
                **({"stream_bytes": num_bytes} if num_bytes else {}),
                "seconds": result.seconds,
                "recipe": record_to_json(config),
            }
        )
        return
    quality = f", test PSNR {test.psnr:.2f} dB, SSIM {test.ssim:.4f}" if test else ""
    quality += f", {num_bytes:,} bytes" if num_bytes else ""
    print_summary(f"{scene.num_gaussians:,} Gaussians{quality}, {result.seconds:,.0f} s -> {command.output}")
