"""How a training run shows itself: a bar on a terminal, a line now and then elsewhere, and what Ctrl-C does."""

import re
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from splatwire.cli._terminal import console, printable_streams
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from splatwire.model import AnchorScene
    from splatwire.train import Listener, Progress, QualityReport, TrainConfig

_SIZE = re.compile(r"(\d+(?:\.\d+)?) *(B|kB|KB|MB)?")
_UNITS = {"": 1, "B": 1, "kB": 1000, "KB": 1000, "MB": 1_000_000}
_NEAR = 0.03
"""A size that is missed by more is told."""
_UNKNOWN = "-:--:--"
_PLAIN_INTERVAL_S = 30.0
"""Without a terminal, a line this often."""

_RECIPE = {
    "preset": attrgetter("preset"),
    "model": attrgetter("model.__class__"),
    "lmbda": attrgetter("weights.rate"),
    "size": attrgetter("weights.size"),
    "iterations": attrgetter("marks.settled"),
    "voxel-size": attrgetter("voxel_size"),
    "growth-interval": attrgetter("marks.growth_interval"),
    "refine": attrgetter("refine.steps"),
    "loss": attrgetter("losses.models", "losses.first"),
    "loss-share": attrgetter("losses.share"),
    "background": attrgetter("background"),
    "seed": attrgetter("seed"),
}
"""Options of a recipe, and where it has them."""


def check_same_recipe(given: Iterable[str], asked: "TrainConfig", kept: "TrainConfig") -> None:
    """Refuses options that a run that goes on could not follow: its recipe is that of the checkpoint.

    Args:
        given: Options that the user gave.
        asked: The recipe that they make.
        kept: That of the checkpoint.

    Raises:
        InvalidValueError: If they differ in one of them.
    """
    other = [name for name in given if name in _RECIPE and _RECIPE[name](asked) != _RECIPE[name](kept)]
    if other:
        options = ", ".join(f"--{name}" for name in other)
        raise InvalidValueError(f"{options}: the checkpoint was made with another value, which --resume keeps")


@contextmanager
def watch(on_test: Any) -> "Iterator[Listener]":
    """Shows progress on standard error, and turns the first Ctrl-C into a polite stop."""
    from rich.progress import Progress as Bars

    from splatwire.train import Listener

    shown = console(stderr=True)
    stop: list[bool] = []
    tests: list[str] = []
    printed = [time.monotonic()]

    def interrupted(number: int, frame: Any) -> None:
        if stop:
            raise KeyboardInterrupt
        stop.append(True)
        shown.print("stopping after this iteration; press Ctrl-C again to stop at once without a checkpoint")

    with Bars(*columns(), console=shown, expand=True, disable=not shown.is_terminal) as bars, printable_streams():
        task = bars.add_task("starting", total=None, left=_UNKNOWN)

        def progress(now: "Progress") -> None:
            text = line(now) + "".join(tests[-1:])
            bars.update(task, completed=now.iteration, total=now.iterations, description=text, left=time_left(now))
            if not shown.is_terminal and time.monotonic() - printed[0] > _PLAIN_INTERVAL_S:
                printed[0] = time.monotonic()
                plain = f"{now.iteration}/{now.iterations} {text}, {time_left(now)} left"
                shown.print(plain, soft_wrap=True)

        def tested(report: "QualityReport") -> None:
            tests.append(f", test {report.psnr:.2f} dB")
            on_test(report)

        def refining(share: float) -> None:
            bars.update(task, description=f"fitting the context model again, {share:.0%}")

        before = signal.signal(signal.SIGINT, interrupted)
        try:
            yield Listener(progress, tested, lambda: bool(stop), refining)
        finally:
            signal.signal(signal.SIGINT, before)


def columns() -> "tuple[ProgressColumn, ...]":
    """Counter and time left come first and whole; what does not fit into the terminal is cut off the description."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.table import Column

    whole, rest = Column(no_wrap=True), Column(ratio=1, no_wrap=True, overflow="ellipsis")
    return (
        MofNCompleteColumn(table_column=whole),
        TextColumn("{task.fields[left]}", markup=False, table_column=whole),
        BarColumn(bar_width=10),
        TextColumn("{task.description}", markup=False, table_column=rest),
    )


def line(now: "Progress") -> str:
    """What a run has come to, in one line."""
    size = f", ~{now.estimated_bytes / 1e6:.2f} MB" if now.estimated_bytes is not None else ""
    speed = "" if now.iterations_per_second is None else f", {now.iterations_per_second:.1f} it/s"
    return f"loss {now.loss:.4f}, L1 {now.l1:.4f}, {now.num_anchors:,} anchors{size}{speed}"


def time_left(now: "Progress") -> str:
    """How long the rest of a run takes at its speed, as hours:minutes:seconds."""
    if now.iterations_per_second is None:
        return _UNKNOWN
    return str(timedelta(seconds=round((now.iterations - now.iteration) / now.iterations_per_second)))


def parsed_size(text: str) -> int:
    """Bytes that a text such as `500kB` asks for.

    Raises:
        InvalidValueError: If it is none, or less than a byte.
    """
    found = _SIZE.fullmatch(text.strip())
    num_bytes = round(float(found[1]) * _UNITS[found[2] or ""]) if found else 0
    if num_bytes < 1:
        raise InvalidValueError(f"--size takes bytes such as 500kB, 1.2MB or 500000, not {text!r}")
    return num_bytes


def told_size(scene: "AnchorScene", wanted: int) -> int | None:
    """Bytes of a scene's stream, if some were asked for; says so if they were missed."""
    if not wanted:
        return None
    from splatwire.train.size import stream_bytes

    num_bytes = stream_bytes(scene)
    if abs(num_bytes / wanted - 1) > _NEAR:
        advice = "a longer run or another --lmbda comes closer"
        print(f"the stream has {num_bytes:,} bytes where --size asks for {wanted:,}: {advice}", file=sys.stderr)
    return num_bytes
