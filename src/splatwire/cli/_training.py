"""How a training run shows itself: a bar on a terminal, a line now and then elsewhere, and what Ctrl-C does."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from splatwire.train import Listener, Progress, QualityReport

_PLAIN_INTERVAL_S = 30.0
"""Without a terminal, a line this often."""


@contextmanager
def watch(on_test: Any) -> "Iterator[Listener]":
    """Shows progress on standard error, and turns the first Ctrl-C into a polite stop."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    from splatwire.train import Listener

    console = Console(stderr=True)
    stop: list[bool] = []
    tests: list[str] = []
    printed = [time.monotonic()]

    def interrupted(number: int, frame: Any) -> None:
        if stop:
            raise KeyboardInterrupt
        stop.append(True)
        console.print("stopping after this iteration; press Ctrl-C again to stop at once without a checkpoint")

    with Bars(*columns(), console=console, expand=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("starting", total=None)

        def progress(now: "Progress") -> None:
            text = line(now) + "".join(tests[-1:])
            bars.update(task, completed=now.iteration, total=now.iterations, description=text)
            if not console.is_terminal and time.monotonic() - printed[0] > _PLAIN_INTERVAL_S:
                printed[0] = time.monotonic()
                left = (now.iterations - now.iteration) / now.iterations_per_second
                plain = f"{now.iteration}/{now.iterations} {text}, {left / 60:.0f} min left"
                console.print(plain, markup=False, highlight=False, soft_wrap=True)

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
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.table import Column

    whole, rest = Column(no_wrap=True), Column(ratio=1, no_wrap=True, overflow="ellipsis")
    return (
        MofNCompleteColumn(table_column=whole),
        TimeRemainingColumn(elapsed_when_finished=True, table_column=whole),
        BarColumn(bar_width=10),
        TextColumn("{task.description}", table_column=rest),
    )


def line(now: "Progress") -> str:
    """What a run has come to, in one line."""
    size = f", ~{now.estimated_bytes / 1e6:.2f} MB" if now.estimated_bytes is not None else ""
    speed = f"{now.iterations_per_second:.1f} it/s"
    return f"loss {now.loss:.4f}, L1 {now.l1:.4f}, {now.num_anchors:,} anchors{size}, {speed}"
