"""Execution of an evaluation's tasks: the engine protocol, and the engine that uses this process."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from splatwire.codec import decode_stream
from splatwire.errors import SplatwireError
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Unit
from splatwire.evaluation.study.work import Decode, Progress, UnitRunner

MAX_ATTEMPTS = 3
"""Maximum number of attempts to compute a task whose worker process dies."""


@dataclass(frozen=True)
class Event:
    """Progress event of an engine.

    Attributes:
        unit: The task (one method on one scene under one loss mask).
        lost_worker: True if the worker of the task died and the task is retried; False if the task is finished.
    """

    unit: Unit
    lost_worker: bool = False


Listener = Callable[[Event], None]


@runtime_checkable
class Engine(Protocol):
    """Executes tasks of an evaluation until the results of all are in the store.

    A task whose worker dies is retried. An error of a task ends the execution.
    """

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Executes tasks and writes their results into the store.

        Args:
            store: Store for the results; every worker must be able to access its folder.
            units: The tasks, without duplicates.
            listener: Called for every finished task and every dead worker.

        Raises:
            SplatwireError: If a task fails, or its workers die `MAX_ATTEMPTS` times.
        """


@dataclass(eq=False)
class InProcess:
    """Executes the tasks of an evaluation sequentially in the current process, with all of its threads.

    Attributes:
        decode: Decoder of received streams.
        progress: Called with a text that names the method of the task, and the finished share of the task's views, 0 to
            1.
    """

    decode: Decode = decode_stream
    progress: Progress | None = None
    _workshop: UnitRunner | None = None

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Executes tasks in this process and writes their results into the store."""
        if self._workshop is None or self._workshop.store is not store:
            self._workshop = UnitRunner(store, self.decode, self._drawing)
        for unit in units:
            self._workshop.compute(unit)
            listener(Event(unit))

    def _drawing(self, label: str, share: float) -> None:
        if self.progress is not None:
            self.progress(f"drawing and scoring '{label}'", share)


def default_workers() -> int:
    """Number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(eq=False)
class Attempts:
    """Counts how often the worker process of each task has died, and gives up after `MAX_ATTEMPTS` times.

    Attributes:
        listener: Called for each death of a worker.
    """

    listener: Listener

    def __post_init__(self) -> None:
        self._count: dict[str, int] = {}

    def lost(self, unit: Unit, reason: str) -> None:
        """Records that the worker of a task died.

        Args:
            unit: The task.
            reason: Reason of the death, for the error message.

        Raises:
            SplatwireError: If workers have died `MAX_ATTEMPTS` times while executing the task.
        """
        self._count[unit.key] = self._count.get(unit.key, 0) + 1
        self.listener(Event(unit, lost_worker=True))
        if self._count[unit.key] >= MAX_ATTEMPTS:
            raise SplatwireError(
                f"{describe(unit)}: its worker died {MAX_ATTEMPTS} times ({reason}); finished units are kept"
            )


def describe(unit: Unit) -> str:
    """Describes a task of an evaluation in one line of text."""
    loss = "without loss" if unit.loss is None else f"{unit.loss.label}, seed {unit.seed}"
    return f"scene {unit.scene}, {Path(unit.stream.path).stem}, {unit.conceal}, {loss}"


def failed(unit: Unit, message: str) -> SplatwireError:
    """Creates the exception for a failed task."""
    return SplatwireError(f"{describe(unit)}: {message}")
