"""Tables and progress bars, drawn by rich; control characters are escaped."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.table import Table

from splatwire.cli._terminal import PrintableStream, one_line, printable, printable_streams


def console(*, stderr: bool = False) -> Console:
    """Returns a console of the package `rich` that prints texts literally, without parsing markup."""
    # A `PrintableStream` would escape the control sequences of rich, too.
    stream = sys.stderr if stderr else sys.stdout
    while isinstance(stream, PrintableStream):
        stream = stream.target
    return _Console(file=stream, markup=False, emoji=False, highlight=False)


class _Console(Console):
    """Rich console that does not handle the error of a closed pipe, so that `main` handles it.

    The original class would exit with status 1.
    """

    def on_broken_pipe(self) -> None:
        raise


def print_table(table: RenderableType) -> None:
    """Prints a rich table on standard output with control characters in its texts escaped."""
    console().print(_Printable(table))


class _Printable:
    """Wrapper of an object that `rich` prints; escapes control characters in texts."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        for segment in console.render(self._inner, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


def print_rows(
    headings: Sequence[str], rows: Sequence[Sequence[str]], title: str, caption: str | None, best: Sequence[int]
) -> None:
    """Prints a table of texts on standard output."""
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    for number, row in enumerate(rows):
        table.add_row(*row, style="bold green" if number in best else None)
    print_table(table)


def print_facts(groups: Sequence[Sequence[tuple[str, str]]], title: str, *, aligned: bool) -> None:
    """Prints names and values on standard output."""
    table = Table(title=title, title_justify="left", show_header=False)
    if aligned:
        table.add_column(style="bold")
        table.add_column(justify="right")
    for group in groups:
        table.add_section()
        for name, value in group:
            table.add_row(name, value)
    print_table(table)


@contextlib.contextmanager
def bars() -> Iterator[Callable[[str, float], None] | None]:
    """Context that shows a progress bar for each task on standard error.

    Yields:
        Function that updates the display, given the name of a task and its finished share, 0 to 1. None if standard
        error is not a terminal.
    """
    shown = console(stderr=True)
    if not shown.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description:<34}", markup=False), BarColumn(bar_width=30), TimeElapsedColumn())
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=shown) as progress, printable_streams():  # rich has replaced the standard streams

        def report(task: str, share: float) -> None:
            if task not in tasks:
                tasks[task] = progress.add_task(one_line(task), total=1.0)
            progress.update(tasks[task], completed=share)

        yield report
