"""Output conventions of subcommands: results on standard output, everything else on standard error."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, TypeAlias

from splatwire.cli._terminal import one_line
from splatwire.errors import InvalidValueError
from splatwire.files.json_text import json_text

LINE_INTERVAL_S = 10.0
"""Interval between two progress lines of one task if no terminal shows progress bars, seconds."""
_TERMINAL_ANYWAY = ("FORCE_COLOR", "TTY_COMPATIBLE")
"""Environment variables that make rich treat a pipe as a terminal. If none is set, rich is not imported for pipes."""
Reporter: TypeAlias = Callable[[str, float], None]
"""Called with the name of the current task and its finished share, 0 to 1."""


def refuse_options(options: Any, names: Sequence[str], why: str) -> None:
    """Raises an error if the user has set one of the named options to another value than the default.

    Args:
        options: Options of a subcommand.
        names: Names of the fields to check.
        why: End of the error message after the name of the option.

    Raises:
        InvalidValueError: If an option is set.
    """
    for name in names:
        if getattr(options, name) != getattr(type(options), name):
            raise InvalidValueError(f"--{name.replace('_', '-')} {why}")


def print_json(content: Mapping[str, Any]) -> None:
    """Prints a JSON object in one line; numbers that are not finite become null.

    Raises:
        InvalidValueError: If standard output is closed.
    """
    if sys.stdout is None:
        raise InvalidValueError("standard output is closed: --json has nowhere to go")
    print(json_text(content))


def print_summary(text: str, output: str = "") -> None:
    """Prints a summary line on standard output, or on standard error if standard output carries data."""
    print(one_line(text), file=sys.stderr if output == "-" or sys.stdout is None else sys.stdout)


def print_table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], title: str, *, caption: str | None = None,
    best: Sequence[int] = (),
) -> None:  # fmt: skip
    """Prints a table on standard output.

    Args:
        headings: Heading of each column; the first column is left-justified, all others right-justified.
        rows: Texts of each row.
        title: Headline.
        caption: Text below the table.
        best: Indices of the rows that are highlighted.
    """
    _rich().print_rows(headings, rows, title, caption, best)


def print_facts(groups: Sequence[Sequence[tuple[str, str]]], title: str, *, aligned: bool = False) -> None:
    """Prints names and values as a table on standard output.

    Args:
        groups: Names and values; groups are separated by a line.
        title: Headline.
        aligned: True for bold names and right-justified values.
    """
    _rich().print_facts(groups, title, aligned=aligned)


def _rich() -> Any:
    """Imports the module that prints with the library rich."""
    # Deferred, because results as JSON and progress in plain lines do not need rich.
    from splatwire.cli import _rich as drawn

    return drawn


@contextmanager
def progress_bars() -> Iterator[Reporter]:
    """Shows progress on standard error: bars on a terminal, otherwise plain lines."""
    with ExitStack() as stack:
        shown = None
        if sys.stderr.isatty() or any(name in os.environ for name in _TERMINAL_ANYWAY):
            with suppress(ModuleNotFoundError):
                shown = stack.enter_context(_rich().bars())
        yield shown or _plain_reporter()


def _plain_reporter() -> Reporter:
    """Returns a progress reporter that prints plain lines."""
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
