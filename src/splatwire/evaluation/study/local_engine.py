"""Runs the tasks of a study in processes of this machine; a process that dies is replaced."""

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from splatwire.errors import SplatwireError
from splatwire.evaluation.study.engines import Attempts, Event, Listener, failed
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Unit
from splatwire.evaluation.study.work import run_unit, use_one_thread

_GRACE_S = 5.0
_SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable with which Python does not import from the current folder."""


@dataclass(frozen=True)
class LocalEngine:
    """Executes tasks in parallel processes of this machine.

    Attributes:
        workers: Number of concurrent processes.
    """

    workers: int

    def run(self, store: Store, units: Sequence[Unit], listener: Listener) -> None:
        """Executes the tasks of an evaluation in worker processes that write results into the store."""
        waiting, attempts = deque(units), Attempts(listener)
        workers = list[_Worker]()
        try:
            for _ in range(min(self.workers, len(units))):
                workers.append(_Worker.start(str(store.root)))
            while waiting or any(worker.unit for worker in workers):
                for worker in workers:
                    if worker.unit is None and waiting:
                        worker.give(waiting.popleft())
                for worker in _await_finished(workers):
                    unit, problem, alive = worker.result()
                    if alive and problem is not None:
                        raise failed(unit, problem)
                    if alive:
                        listener(Event(unit))
                        continue
                    attempts.lost(unit, problem or "no reason given")
                    waiting.appendleft(unit)
                    workers[workers.index(worker)] = _Worker.start(str(store.root))
        finally:
            for worker in workers:
                worker.stop()


@dataclass(eq=False)
class _Worker:
    """A worker process and the task that it executes."""

    process: BaseProcess
    pipe: Connection
    unit: Unit | None = None

    @staticmethod
    def start(root: str) -> "_Worker":
        context = multiprocessing.get_context("spawn")  # a fork would inherit the threads of numba and torch
        ours, theirs = context.Pipe()
        process = context.Process(target=_work_loop, args=(theirs, root), daemon=True)
        # a terminal sends Ctrl-C to all processes; the parent process ends this one
        with _folder_not_imported(), _interrupts_blocked():
            process.start()
        theirs.close()
        return _Worker(process, ours)

    def give(self, unit: Unit) -> None:
        self.unit = unit
        with contextlib.suppress(OSError):  # the process has died; `result` detects it
            self.pipe.send(unit)

    def result(self) -> tuple[Unit, str | None, bool]:
        """Returns the outcome of the worker's task, after the task has ended or the process has died.

        Returns:
            Three values: the task; the error message of the task, None if the task succeeded; and a flag, True if the
            process is still alive.
        """
        unit, self.unit = self.unit, None
        assert unit is not None
        try:
            if self.pipe.poll():
                return unit, self.pipe.recv(), True
        except (EOFError, OSError):
            pass
        self.process.join(_GRACE_S)
        return unit, f"exit status {self.process.exitcode}", False

    def stop(self) -> None:
        self.process.terminate()
        self.process.join(_GRACE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join(_GRACE_S)
        self.pipe.close()


@contextlib.contextmanager
def _folder_not_imported() -> Iterator[None]:
    """Context in which starting processes import no module of the current folder, such as a `random.py`.

    Once started, a process imports from the same folders as this one.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Context manager that blocks the signal SIGINT (Ctrl-C), except on Windows.

    This process receives the signal after the context. Processes that are started within the context never receive it.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # its start would end the blocking
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _await_finished(workers: list[_Worker]) -> list[_Worker]:
    """Waits until at least one worker process has finished a task or died, and returns all such workers."""
    busy = [worker for worker in workers if worker.unit is not None]
    sources: list[Any] = [source for worker in busy for source in (worker.pipe, worker.process.sentinel)]
    ready = wait(sources)
    return [worker for worker in busy if worker.pipe in ready or worker.process.sentinel in ready]


def _work_loop(pipe: Connection, root: str) -> None:
    """Main loop of a worker process: executes the tasks that arrive through a pipe.

    Args:
        pipe: Connection to the parent process.
        root: Folder of the store.
    """
    use_one_thread()
    while True:
        try:
            unit = pipe.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            failure = _failure_of(root, unit)
        except KeyboardInterrupt:
            return
        with contextlib.suppress(BrokenPipeError):  # the parent process has ended
            pipe.send(failure)


def _failure_of(root: str, unit: Unit) -> str | None:
    try:
        run_unit(root, unit)
    except (SplatwireError, OSError) as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None
