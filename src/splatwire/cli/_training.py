"""Common code of `train` for all models: data, preset, sizes, options of --resume; progress display with Ctrl-C."""

import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from datetime import timedelta
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TextColumn
from rich.progress import Progress as Bars
from rich.table import Column

from splatwire.cli._rich import console
from splatwire.cli._signals import first_interrupt
from splatwire.cli._terminal import printable_streams
from splatwire.cli.train import Train
from splatwire.data import Dataset, dataset_layout, open_dataset
from splatwire.errors import InvalidValueError, NoViewsError
from splatwire.files.atomic_write import atomic_output
from splatwire.neural.training import Listener, Progress, QualityReport
from splatwire.neural.training.size import stream_bytes
from splatwire.types import AnchorScene

Config = TypeVar("Config")
_SIZE = re.compile(r"(\d+(?:\.\d+)?) *(B|kB|KB|MB)?")
_UNITS = {"": 1, "B": 1, "kB": 1000, "KB": 1000, "MB": 1_000_000}
_SIZE_TOLERANCE = 0.03
"""Relative difference to the requested size above which a message is printed."""
_UNKNOWN_TIME = "-:--:--"
_PLAIN_INTERVAL_S = 30.0
"""Interval of progress lines without a terminal, seconds."""

_PRESET_OF_LAYOUT = {"blender": "synthetic_nerf", "bungeenerf": "bungeenerf"}
DEFAULT_ITERATIONS = 2400
"""Default number of iterations, on every device: on a CPU, training then takes minutes instead of days."""


def preset_of(command: Train) -> str:
    """Returns the name of the training preset. For `--preset auto`, the layout of the dataset determines the preset."""
    if command.preset != "auto":
        return command.preset
    return _PRESET_OF_LAYOUT.get(dataset_layout(Path(command.data)) or "", "mipnerf360")


def training_data(
    command: Train, test_views: str | None, background: tuple[float, float, float]
) -> tuple[Dataset, Dataset | None]:
    """Opens the training and test views of the dataset; prints a message if there are no test views.

    Args:
        command: Options of `splatwire train`.
        test_views: Rule that selects the test views; None for the default rule of the dataset's layout.
        background: RGB behind transparent parts of photos.
    """

    def opened(split: str) -> Dataset:
        return open_dataset(
            Path(command.data),
            split=split,
            images=command.images,
            max_width=command.max_width,
            test_views=test_views,
            background=background,
        )

    train = opened("train")
    try:
        test = opened("test")
    except NoViewsError as error:
        print(f"no test views: {error}", file=sys.stderr)
        return train, None
    return train, replace(test, cameras=test.cameras.relative_to(train.cameras.origin))


def changed_options(command: Train) -> list[str]:
    """Returns the names of the options that the user changed from their defaults."""
    optional = [field for field in fields(command) if field.default is not MISSING]
    return [field.name.replace("_", "-") for field in optional if getattr(command, field.name) != field.default]


def preview_writer(path: str | None) -> Callable[[QualityReport], None]:
    """Returns a callback that writes the preview picture of each quality test during training to a file.

    Args:
        path: Path of the image file; None to write nothing.
    """

    def save(report: QualityReport) -> None:
        if path:
            pixels = np.rint(np.clip(report.preview, 0, 1) * 255).astype(np.uint8)
            with atomic_output(path) as unfinished:
                Image.fromarray(pixels).save(unfinished)

    return save


def stopped_early(iteration: int, iterations: int, *, has_init: bool) -> KeyboardInterrupt:
    """Prints how to continue a training that the user stopped, and returns the exception that ends the command.

    Args:
        iteration: Last iteration.
        iterations: Number of iterations of the whole training.
        has_init: True if the command had the option `--init`, which `--resume` then replaces.
    """
    resume = "--resume in place of --init" if has_init else "--resume"
    print(
        f"stopped after iteration {iteration:,} of {iterations:,}; the same command with {resume} continues from there",
        file=sys.stderr,
    )
    return KeyboardInterrupt()


ANCHOR_RECIPE_OPTIONS: dict[str, Callable[[Any], object]] = {
    "preset": attrgetter("preset"),
    "model": attrgetter("model.__class__"),
    "lmbda": attrgetter("weights.rate"),
    "size": attrgetter("weights.target_bytes"),
    "iterations": attrgetter("milestones.main_iterations"),
    "voxel-size": attrgetter("voxel_size"),
    "growth-interval": attrgetter("milestones.growth_interval"),
    "refine": attrgetter("refine.steps"),
    "loss": attrgetter("packet_loss.models", "packet_loss.received_shares"),
    "loss-share": attrgetter("packet_loss.lossy_share"),
    "background": attrgetter("background"),
    "seed": attrgetter("seed"),
}
"""Options of the recipe of anchors, each with a function that returns its value from a training configuration."""
GAUSSIAN_RECIPE_OPTIONS: dict[str, Callable[[Any], object]] = {
    name: attrgetter(name) for name in ("preset", "gaussians", "degree", "iterations", "quality", "background", "seed")
} | {"loss": attrgetter("packet_loss"), "model": lambda config: "gaussians"}
"""Options of the recipe of explicit Gaussians, as in `ANCHOR_RECIPE_OPTIONS`."""


def check_same_recipe(
    set_options: Iterable[str],
    requested: Config,
    checkpointed: Config,
    getters: Mapping[str, Callable[[Config], object]],
) -> None:
    """Raises an error if options would change the training settings of a run resumed from a checkpoint.

    Args:
        set_options: Names of the options set by the user.
        requested: Training settings that result from the options.
        checkpointed: Training settings in the checkpoint.
        getters: For each option that must not change, a function that reads its value from the training settings.

    Raises:
        InvalidValueError: If such an option has another value than in the checkpoint.
    """
    other = [
        name for name in set_options if name in getters and getters[name](requested) != getters[name](checkpointed)
    ]
    if other:
        options = ", ".join(f"--{name}" for name in other)
        raise InvalidValueError(f"{options}: the checkpoint was made with another value, which --resume keeps")


def check_same_photos(photo_size: tuple[int, int] | None, train: Dataset) -> None:
    """Raises an error if a run is resumed with photos of another size than those of its checkpoint.

    Args:
        photo_size: Width and height of the photos in the checkpoint, pixels; None if not known.
        train: Dataset of the training views.

    Raises:
        InvalidValueError: If the sizes differ.
    """
    width, height = train.cameras.width, train.cameras.height
    if photo_size not in (None, (width, height)):
        raise InvalidValueError(
            "the checkpoint was made with photos of {} x {} pixels, and those of the dataset are {} x {}: "
            "give --images and --max-width as at the start of the run".format(*photo_size, width, height)
        )


@contextmanager
def training_display(on_test: Any, final_task_name: str = "fitting the context model again") -> Iterator[Listener]:
    """Context of a training: shows its progress on standard error, and handles Ctrl-C.

    The first Ctrl-C stops the training after the current iteration, with a checkpoint. A second Ctrl-C stops the
    training at once.

    Args:
        on_test: Called with the quality report of each test during the training.
        final_task_name: Name of the final task, after the last iteration, for the progress display.

    Yields:
        Callbacks for the training.
    """
    shown = console(stderr=True)
    stop: list[bool] = []
    tests: list[str] = []
    printed = [time.monotonic()]

    def interrupted() -> None:
        stop.append(True)
        shown.print("stopping after this iteration; press Ctrl-C again to stop at once without a checkpoint")

    with Bars(*columns(), console=shown, expand=True, disable=not shown.is_terminal) as bars, printable_streams():
        task = bars.add_task("starting", total=None, left=_UNKNOWN_TIME)

        def progress(now: Progress) -> None:
            text = line(now) + "".join(tests[-1:])
            bars.update(task, completed=now.iteration, total=now.iterations, description=text, left=time_left(now))
            if not shown.is_terminal and time.monotonic() - printed[0] > _PLAIN_INTERVAL_S:
                printed[0] = time.monotonic()
                plain = f"{now.iteration}/{now.iterations} {text}, {time_left(now)} left"
                shown.print(plain, soft_wrap=True)

        def tested(report: QualityReport) -> None:
            tests.append(f", test {report.psnr:.2f} dB")
            on_test(report)

        def final_task(share: float) -> None:
            bars.update(task, description=f"{final_task_name}, {share:.0%}")

        with first_interrupt(interrupted):
            yield Listener(progress, tested, lambda: bool(stop), final_task)


def columns() -> tuple[ProgressColumn, ...]:
    """Returns the columns of the progress bar for a training run."""
    # Counter and remaining time have priority over the description.
    whole, rest = Column(no_wrap=True), Column(ratio=1, no_wrap=True, overflow="ellipsis")
    return (
        MofNCompleteColumn(table_column=whole),
        TextColumn("{task.fields[left]}", markup=False, table_column=whole),
        BarColumn(bar_width=10),
        TextColumn("{task.description}", markup=False, table_column=rest),
    )


def line(now: Progress) -> str:
    """Formats the progress of a training as one line of text.

    Args:
        now: State of the training after the last completed iteration.
    """
    size = f", ~{now.estimated_bytes / 1e6:.2f} MB" if now.estimated_bytes is not None else ""
    speed = "" if now.iterations_per_second is None else f", {now.iterations_per_second:.1f} it/s"
    return f"loss {now.loss:.4f}, L1 {now.l1:.4f}, {now.num_elements:,} {now.elements}{size}{speed}"


def time_left(now: Progress) -> str:
    """Returns the estimated remaining time of a training, as text in hours:minutes:seconds.

    Args:
        now: State of the training, with its speed so far.
    """
    if now.iterations_per_second is None:
        return _UNKNOWN_TIME
    return str(timedelta(seconds=round((now.iterations - now.iteration) / now.iterations_per_second)))


def parsed_size(text: str) -> int:
    """Parses a size with unit, for example `500kB`, and returns bytes.

    Raises:
        InvalidValueError: If the text is not a size, or is less than a byte.
    """
    match = _SIZE.fullmatch(text.strip())
    num_bytes = round(float(match[1]) * _UNITS[match[2] or ""]) if match else 0
    if num_bytes < 1:
        raise InvalidValueError(f"--size takes bytes such as 500kB, 1.2MB or 500000, not {text!r}")
    return num_bytes


def checked_size(scene: AnchorScene, target_bytes: int) -> int | None:
    """Returns the size of a trained scene's stream in bytes; prints a message if the size is far from the target.

    Args:
        scene: The scene.
        target_bytes: Target size, bytes; 0 for none.

    Returns:
        The size; None without a target.
    """
    if not target_bytes:
        return None
    num_bytes = stream_bytes(scene)
    if abs(num_bytes / target_bytes - 1) > _SIZE_TOLERANCE:
        advice = "a longer run or another --lmbda comes closer"
        print(f"the stream has {num_bytes:,} bytes where --size asks for {target_bytes:,}: {advice}", file=sys.stderr)
    return num_bytes
