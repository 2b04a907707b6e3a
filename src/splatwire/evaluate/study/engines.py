"""Where units of work run: what every engine promises, and the one that is this process."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from splatwire.codec import decode_stream
from splatwire.errors import SplatwireError
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Unit
from splatwire.evaluate.study.work import Decode, Progress, Workshop

MAX_ATTEMPTS = 3
"""How often a unit is tried when its worker dies."""


@dataclass(frozen=True)
class Event:
    """What an engine tells while it works.

    Attributes:
        unit: The unit.
        lost_worker: True if its worker died and the unit is tried again; False if it is finished.
    """

    unit: Unit
    lost_worker: bool = False


Listener = Callable[[Event], None]


@runtime_checkable
class Engine(Protocol):
    """Runs units until each of them is in the store.

    A worker that dies costs the unit that it worked on, which is tried again; an error of a unit itself ends the run,
    because it would come again. What is finished stays.
    """

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Runs units.

        Args:
            store: Where records go; every worker must see this folder.
            units: The units, each once.
            listener: Told about every finished unit and every lost worker.

        Raises:
            SplatwireError: If a unit fails, or its worker dies `MAX_ATTEMPTS` times.
        """


@dataclass(eq=False)
class InProcess:
    """Units in this process, one after another, with all of its threads.

    Attributes:
        decode: How a received stream becomes a scene.
        progress: Called with the row and the share of its views that is done.
    """

    decode: Decode = decode_stream
    progress: Progress | None = None
    _workshop: Workshop | None = None

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """See `Engine.run`."""
        if self._workshop is None or self._workshop.store is not store:
            self._workshop = Workshop(store, self.decode, self._drawing)
        for unit in units:
            self._workshop.compute(unit)
            listener(Event(unit))

    def _drawing(self, label: str, share: float) -> None:
        if self.progress is not None:
            self.progress(f"drawing and scoring '{label}'", share)


def default_workers() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(eq=False)
class Attempts:
    """Counts how often the workers of units died.

    Attributes:
        listener: Told about every one of them.
    """

    listener: Listener

    def __post_init__(self) -> None:
        self._count: dict[str, int] = {}

    def lost(self, unit: Unit, reason: str) -> None:
        """Notes that the worker of a unit died.

        Raises:
            SplatwireError: If that happened too often.
        """
        self._count[unit.key] = self._count.get(unit.key, 0) + 1
        self.listener(Event(unit, lost_worker=True))
        if self._count[unit.key] >= MAX_ATTEMPTS:
            raise SplatwireError(
                f"{describe(unit)}: its worker died {MAX_ATTEMPTS} times ({reason}); finished units are kept"
            )


def describe(unit: Unit) -> str:
    """A unit in one line."""
    loss = "without loss" if unit.loss is None else f"{unit.loss.label}, seed {unit.seed}"
    return f"scene {unit.scene}, {Path(unit.stream.path).stem}, {unit.conceal}, {loss}"


def failed(unit: Unit, message: str) -> SplatwireError:
    """The error of a unit that fails by itself."""
    return SplatwireError(f"{describe(unit)}: {message}")
