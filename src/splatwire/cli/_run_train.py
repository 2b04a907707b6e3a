"""Implementation of `splatwire train`: trains a scene from photos with known cameras."""

import dataclasses
import sys
from pathlib import Path
from typing import Any

from splatwire.cli._files import prepared_output, refuse_own_input
from splatwire.cli._output import print_json, print_summary, refuse_options
from splatwire.cli._scenes import chosen_background
from splatwire.cli._trained_gaussians import GAUSSIAN_MODEL, check_gaussian_options, run_gaussians
from splatwire.cli._training import (
    ANCHOR_RECIPE_OPTIONS,
    DEFAULT_ITERATIONS,
    changed_options,
    check_same_photos,
    check_same_recipe,
    checked_size,
    parsed_size,
    preset_of,
    preview_writer,
    stopped_early,
    training_data,
    training_display,
)
from splatwire.cli.train import Train
from splatwire.data import Dataset
from splatwire.errors import BackendUnavailableError, InvalidValueError, UnknownNameError
from splatwire.io import open_scene, save_scene
from splatwire.neural.render.gsplat_backend import check_gsplat
from splatwire.neural.training import (
    RunOptions,
    TrainConfig,
    TrainResult,
    create_config,
    load_checkpoint,
    save_checkpoint,
    train_scene,
)
from splatwire.neural.training.checkpoint import record_to_json
from splatwire.neural.training.config import PacketLossConfig
from splatwire.neural.training.device import check_cuda, has_cuda
from splatwire.neural.training.finetune import fine_tuning_config, model_of, state_of_scene
from splatwire.neural.training.initial import initial_state, points_of
from splatwire.neural.training.presets import DEFAULT_MODEL
from splatwire.neural.training.state import TrainState
from splatwire.types.background import BLACK

_DEVICES = ("auto", "cpu", "cuda")
_DEVICE_NAMES = {"cpu": "CPU", "cuda": "GPU"}
_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
_GAUSSIAN_OPTIONS = ("gaussians", "degree", "quality", "serve", "page", "host")
"""Options that apply only to explicit Gaussians."""
FINE_TUNING_ITERATIONS = 720
"""Default number of iterations when training continues from a finished scene."""


def run(command: Train) -> None:
    """Runs `splatwire train`: trains a scene from photos."""
    if command.model == GAUSSIAN_MODEL:
        check_gaussian_options(command)
    else:
        refuse_options(command, _GAUSSIAN_OPTIONS, f"is for --model {GAUSSIAN_MODEL}")
    device = _check(command)
    if command.model == GAUSSIAN_MODEL:
        run_gaussians(command, device, _DEVICE_NAMES[device])
        return
    output = prepared_output(Path(command.output), expected_suffix="")
    checkpoint = output.with_name(output.name + ".checkpoint")
    if command.resume:
        state, config = load_checkpoint(checkpoint)
        check_same_recipe(changed_options(command), _config(command), config, ANCHOR_RECIPE_OPTIONS)
        train, test = _datasets(command, config)
        check_same_photos(state.photo_size, train)
    else:
        state, config, train, test = _initial_training(command, _DEVICE_NAMES[device])
        save_checkpoint(state, config, checkpoint)  # reports an unwritable checkpoint now instead of in an hour
    options = RunOptions(checkpoint, command.checkpoint_interval)
    with training_display(preview_writer(command.preview)) as listener:
        result = train_scene(train, test, config, state=state, options=options, listener=listener, device=device)
    if result.stopped:
        raise stopped_early(result.state.iteration, config.milestones.iterations, has_init=command.init is not None)
    save_scene(result.scene, output)
    _report(command, result, config)


def _initial_training(command: Train, device_name: str) -> tuple[TrainState, TrainConfig, Dataset, Dataset | None]:
    """Prepares a new training: returns initial state, configuration, training dataset, and test dataset or None.

    Args:
        command: Options of `splatwire train`.
        device_name: Name of the training device, for messages.
    """
    chosen = " (chosen by the data)" if command.preset == "auto" else ""
    start = None if command.init is None else open_scene(command.init)
    if start is not None and (model := model_of(start)) is not None:
        return _continued_training(command, start, model, f"{chosen}, on the {device_name}")
    config = _config(command)
    train, test = _datasets(command, config)
    num_fine_tuning = config.milestones.fine_tuning_iterations
    more = f" and {num_fine_tuning:,} more for losses" if num_fine_tuning else ""
    iterations = f"{config.milestones.main_iterations:,} iterations{more}"
    summary = f"preset {config.preset}{chosen}, {iterations} on the {device_name}"
    print(summary, file=sys.stderr)
    if start is not None:
        train = dataclasses.replace(train, points=points_of(start))
    if train.points is None or not train.points.num_points:
        print("the dataset has no points: the first anchors get random positions", file=sys.stderr)
    return initial_state(train, config), config, train, test


def _continued_training(
    command: Train, scene: Any, model: str, details: str
) -> tuple[TrainState, TrainConfig, Dataset, Dataset | None]:
    """Prepares a training that continues with a finished scene (fine-tuning).

    Args:
        command: Options of `splatwire train`.
        scene: The finished scene.
        model: Name of the scene's model.
        details: Text to append to the line that announces the training, such as the device.

    Returns:
        Initial state, configuration, training photos, and test photos. The last is None if there are no test photos.
    """
    if command.voxel_size is not None or command.growth_interval is not None:
        raise InvalidValueError(
            "--voxel-size and --growth-interval do not apply to a finished scene, because its anchors keep "
            "their positions and none are added"
        )
    if command.model not in (None, model):
        raise InvalidValueError(f"--model: {command.init} has model {model}, which cannot be changed")
    iterations = FINE_TUNING_ITERATIONS if command.iterations is None else command.iterations
    config = fine_tuning_config(_config(dataclasses.replace(command, iterations=iterations, model=model)), scene)
    config = dataclasses.replace(config, background=chosen_background(command.background) or scene.background)
    train, test = _datasets(command, config)
    print(
        f"continuing {command.init} for {iterations:,} iterations with preset {config.preset}{details}", file=sys.stderr
    )
    return state_of_scene(scene, train, config), config, train, test


def _check(command: Train) -> str:
    """Checks the options; returns the name of the training device."""
    if command.init is not None and command.resume:
        raise InvalidValueError("--init is for the start of a run: the checkpoint of --resume has its anchors")
    if command.output == "-":
        raise InvalidValueError("training writes a scene file and a checkpoint beside it: give -o a file")
    refuse_own_input(command.output, command.init)
    if command.preview is not None and prepared_output(Path(command.preview)).suffix.lower() not in _PICTURE_SUFFIXES:
        raise InvalidValueError(f"--preview must end in {', '.join(_PICTURE_SUFFIXES)}, not {command.preview}")
    if command.loss_share is not None and not command.loss:
        raise InvalidValueError("--loss-share needs --loss")
    if command.checkpoint_interval < 1:
        raise InvalidValueError(f"--checkpoint-interval must be 1 or more, not {command.checkpoint_interval}")
    return check_device(command.device)


def _config(command: Train) -> TrainConfig:
    return create_config(
        preset_of(command),
        model=command.model or DEFAULT_MODEL,
        lmbda=command.lmbda,
        size=0 if command.size is None else parsed_size(command.size),
        iterations=DEFAULT_ITERATIONS if command.iterations is None else command.iterations,
        voxel_size=command.voxel_size,
        growth_interval=command.growth_interval,
        refine_steps=command.refine,
        packet_losses=command.loss,
        lossy_share=PacketLossConfig.lossy_share if command.loss_share is None else command.loss_share,
        background=chosen_background(command.background) or BLACK,
        seed=command.seed,
    )


def _datasets(command: Train, config: TrainConfig) -> tuple[Dataset, Dataset | None]:
    return training_data(command, config.test_views, config.background)


def _report(command: Train, result: TrainResult, config: TrainConfig) -> None:
    test, scene, size = result.test, result.scene, checked_size(result.scene, config.weights.target_bytes)
    if command.json:
        print_json(
            {
                "output": command.output,
                "iterations": result.state.iteration,
                "num_anchors": scene.anchors.num_anchors,
                "num_gaussians": int(scene.anchors.mask.sum()),
                "test_psnr": test.psnr if test else None,
                "test_ssim": test.ssim if test else None,
                **({"stream_bytes": size} if size else {}),
                "seconds": result.seconds,
                "recipe": {**record_to_json(config), "marks": record_to_json(config.milestones)},  # former name
            }
        )
        return
    quality = f", test PSNR {test.psnr:.2f} dB, SSIM {test.ssim:.4f}" if test else ""
    quality += f", {size:,} bytes as a stream" if size else ""
    print_summary(f"{scene.anchors.num_anchors:,} anchors{quality}, {result.seconds:,.0f} s -> {command.output}")


def check_device(name: str) -> str:
    """Checks that the requested device is available for training, and returns `cpu` or `cuda`.

    Raises:
        UnknownNameError: If there is no such device.
        BackendUnavailableError: If `cuda` is requested and the GPU cannot be used; `auto` then selects the CPU.
    """
    if name not in _DEVICES:
        raise UnknownNameError("device", name, _DEVICES)
    if name == "cpu":
        return "cpu"
    if name == "auto" and not has_cuda():
        return "cpu"
    try:
        _check_gpu()
    except BackendUnavailableError as error:
        if name == "cuda":
            raise
        print(f"training on the CPU: {error}", file=sys.stderr)
        return "cpu"
    return "cuda"


def _check_gpu() -> None:
    check_cuda()
    print("testing gsplat, which compiles its kernels on first use", file=sys.stderr)
    check_gsplat()
