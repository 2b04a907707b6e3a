"""How verbs talk: results on standard output, everything else on standard error."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import tyro

from splatwire.cli._terminal import console, one_line, printable_streams
from splatwire.errors import InvalidValueError
from splatwire.files.json_text import json_text

if TYPE_CHECKING:
    from splatwire.model.appearance import Scene

JsonFlag = Annotated[bool, tyro.conf.arg(name="json")]
DAMAGED = 3
"""Exit status of a verb whose input is damaged."""


LINE_INTERVAL_S = 10.0
"""Seconds between two lines about one task where no terminal shows bars."""
Reporter: TypeAlias = Callable[[str, float], None]
"""Called with what is being done and the share of it that is done, 0 to 1."""


def refuse_options(options: Any, names: Sequence[str], why: str) -> None:
    """Refuses options that have another value than where they are absent.

    Raises:
        InvalidValueError: If one has.
    """
    for name in names:
        if getattr(options, name) != getattr(type(options), name):
            raise InvalidValueError(f"--{name.replace('_', '-')} {why}")


def print_json(content: Mapping[str, Any]) -> None:
    """Prints one JSON object, all on one line; numbers that JSON does not have become null.

    Raises:
        InvalidValueError: If standard output is closed.
    """
    if sys.stdout is None:
        raise InvalidValueError("standard output is closed: --json has nowhere to go")
    print(json_text(content))


def print_summary(text: str, output: str = "") -> None:
    """Prints a line for a person; on standard error when standard output carries the data."""
    print(one_line(text), file=sys.stderr if output == "-" or sys.stdout is None else sys.stdout)


def tell_lost_harmonics(scene: "Scene", path: str | Path) -> None:
    """Says on standard error what a `.splat` file does not hold: the spherical harmonics of a scene.

    Args:
        scene: What was written.
        path: The file.
    """
    degree = getattr(scene.elements, "degree", 0)
    if degree and Path(path).suffix.lower() == ".splat":
        told = "a .splat file has one colour for all directions"
        print(f"{path}: {told}; the scene's harmonics, of degree {degree}, are not in it", file=sys.stderr)


@contextmanager
def progress_bars() -> Iterator[Reporter]:
    """Shows progress on standard error: bars on a terminal, lines elsewhere and where rich is absent."""
    try:
        from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
    except ModuleNotFoundError:
        yield _lines()
        return
    shown = console(stderr=True)
    if not shown.is_terminal:
        yield _lines()
        return
    columns = (TextColumn("{task.description:<34}", markup=False), BarColumn(bar_width=30), TimeElapsedColumn())
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=shown) as progress, printable_streams():  # rich has put its own streams there

        def report(task: str, share: float) -> None:
            if task not in tasks:
                tasks[task] = progress.add_task(one_line(task), total=1.0)
            progress.update(tasks[task], completed=share)

        yield report


def _lines() -> Reporter:
    """Prints a line when a task begins, and its share at intervals while it goes on."""
    printed: dict[str, float] = {}
    started = time.perf_counter()

    def report(task: str, share: float) -> None:
        now = time.perf_counter()
        if task not in printed:
            print(f"[{now - started:6.1f} s] {task}", file=sys.stderr, flush=True)
        elif now - printed[task] >= LINE_INTERVAL_S and share < 1:
            print(f"[{now - started:6.1f} s] {task}: {share:.0%}", file=sys.stderr, flush=True)
        else:
            return
        printed[task] = now

    return report
