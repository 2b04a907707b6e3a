"""Entry point of the command line: runs the subcommand and prints errors."""

import atexit
import contextlib
import gc
import importlib
import os
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import splatwire
from splatwire.cli._input_warnings import DAMAGED, input_warnings
from splatwire.cli._resources import address_space_warning, file_problem, resource_problem
from splatwire.cli._signals import SignalErrors, StoppedError, status_of
from splatwire.cli._startup_progress import startup_messages
from splatwire.cli._terminal import discard_stderr, one_line, print_failure, printable, printable_streams
from splatwire.cli._verbs import VERBS, overview, unknown_verb
from splatwire.errors import InvalidValueError, SplatwireError, how_to_install
from splatwire.files.atomic_write import with_final_names

_OBJECTS = 200_000
"""Threshold of Python's garbage collector: net number of allocated objects before a collection."""
_MIN_COLUMNS = 20
"""Least width of help texts, characters."""
_REFUSING_DAMAGE = ("serve",)
"""Subcommands that refuse damaged input with a message, also when they read files again."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits the process.

    The exit status is 0 on success, 2 for a user error, 3 for a damaged input or an incomplete transfer, 130 after
    SIGINT (Ctrl-C), and 143 after SIGTERM. Commands that run until they are stopped exit with 0 after both signals:
    `serve`, `live`, `view`, and `receive --follow` once a scene has arrived.

    Args:
        arguments: Command-line arguments after the program name; None for those of this process.
    """
    # Must precede the first use of OpenMP: waiting threads would otherwise spin, which on busy processors slows down
    # all processes, including this one by several times.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    if arguments is None:
        sys.excepthook = _print_traceback
    with _standard_streams(), _signals_as_exit(in_process=arguments is not None), _rare_collections():
        try:
            status: Any = _run(list(sys.argv[1:] if arguments is None else arguments))
        except SystemExit as end:
            status = end.code
        except BrokenPipeError:
            _discard_stdout()
            status = 0
        if arguments is None:
            _end_at_next_interrupt()  # before the output is flushed, which can wait for a reader
        status = _flush_stdout(status)
    sys.exit(status)


def _print_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    with printable_streams():
        traceback.print_exception(kind, error, trace)


def _flush_stdout(status: Any) -> Any:
    """Writes the buffered standard output before the process exits; returns the exit status."""
    if sys.stdout is None:
        return status
    try:
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has exited, e.g. `| head`
        _discard_stdout()
    except OSError as error:
        _discard_stdout()
        return _print_error(f"standard output: {resource_problem(error) or error}")
    return status


def _discard_stdout() -> None:
    """Redirects standard output to the null device.

    It is called when standard output is no longer read. Python would otherwise try to write the rest at exit, and
    report an error.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _standard_streams() -> Iterator[None]:
    """Context that makes printing safe: characters that standard output cannot encode are escaped.

    A closed standard error is replaced by the null device; `print` would otherwise write errors to standard output.
    """
    if getattr(sys.stdout, "errors", None) in ("strict", "surrogateescape") and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")  # e.g. in a terminal with Latin-1
    if sys.stderr is not None:
        yield
        return
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stderr(nowhere):
        yield


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Context in which Python's garbage collector runs rarely, for a faster start and exit."""
    # Loading libraries creates half a million objects, none of which becomes garbage. Default collections, one per 700
    # new objects, take a sixth of a command's start-up time, and two at the end of the process another tenth.
    atexit.register(gc.freeze)
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _end_at_next_interrupt() -> None:
    """Restores the default action of SIGINT, so that another Ctrl-C ends the process at once."""
    # Otherwise, Python prints a traceback for it while objects are freed and the process shuts down.
    # A handler that is not Python's (None) stays, because it could not be set again.
    if _in_main_thread() and signal.getsignal(signal.SIGINT) not in (None, signal.SIG_DFL, signal.SIG_IGN):
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def _signals_as_exit(*, in_process: bool) -> Iterator[None]:
    """Converts SIGINT, SIGTERM and SIGHUP to a regular exit of the process, so that temporary files are removed.

    SIGINT raises KeyboardInterrupt, the others raise StoppedError (`SignalErrors`). Signals that are ignored, or have a
    handler of the caller, keep their action.

    Args:
        in_process: True if the process continues after the command. The previous action of SIGINT is then restored at
            the end.
    """

    def stop(number: int) -> BaseException:
        # Not SystemExit: the loader of plug-ins takes that for an error of a plug-in.
        return KeyboardInterrupt() if number == signal.SIGINT else StoppedError(number)

    if not _in_main_thread():
        yield
        return
    errors, interrupt = SignalErrors(stop), signal.getsignal(signal.SIGINT)
    if interrupt is signal.default_int_handler:
        signal.signal(signal.SIGINT, errors.handle)
    numbers = [n for n in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)) if _is_default(n)]
    before = {number: signal.signal(number, errors.handle) for number in dict.fromkeys(numbers)}
    try:
        with errors.lost_ones_repeated():
            yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if in_process and interrupt is not None:  # None: a handler that is not Python's, which was not replaced
            signal.signal(signal.SIGINT, interrupt)  # Python's own action, or that of the caller


def _is_default(number: int) -> bool:
    return signal.getsignal(number) is signal.SIG_DFL  # keeps signals that `nohup` ignores


def _run(arguments: list[str]) -> int:
    try:
        if arguments in (["--version"], ["-V"]):
            print(f"splatwire {splatwire.__version__}")
            return 0
        if not arguments or arguments[0] in ("--help", "-h"):
            print(overview())
            return 0
        if arguments == ["--manual"]:
            print(importlib.import_module("splatwire.cli._manual").manual_page(), end="")  # imports tyro
            return 0
        command = _parse(arguments)
        waits = startup_messages(arguments[0])
        with printable_streams(), waits, input_warnings() as warnings:
            if warning := address_space_warning():
                print(f"splatwire: warning: {warning}", file=sys.stderr)
            try:
                _execute(arguments[0], command)
            except BrokenPipeError:  # the reader of the output has exited; damaged input still fails
                _discard_stdout()
    except BrokenPipeError:
        raise
    except (Exception, KeyboardInterrupt) as error:
        if (status := _signal_status(error)) is not None:
            _end_at_next_interrupt()
            try:
                print("splatwire: stopped", file=sys.stderr)
            except OSError:  # its reader has exited, or the disk is full
                discard_stderr()
            return status
        if isinstance(error, SplatwireError):
            return _print_error(str(error))
        if problem := resource_problem(error):
            return _print_error(problem)
        if isinstance(error, OSError):
            return _print_error(file_problem(error))
        if isinstance(error, ModuleNotFoundError) and (how := how_to_install(error.name)):
            return _print_error(how)
        raise
    return _print_damage(command) if warnings.damaged and arguments[0] not in _REFUSING_DAMAGE else 0


def _print_damage(command: Any) -> int:
    """Prints an error about damaged input, unless `--accept-damage` is set; returns the exit status.

    Args:
        command: Options of the subcommand.
    """
    if getattr(command, "accept_damage", False):
        return 0
    how = ", or accept this result with --accept-damage" if hasattr(command, "accept_damage") else ""
    print_failure(f"the input is damaged, and only its intact parts were used: fetch it again{how}")
    return DAMAGED


def _signal_status(error: BaseException) -> int | None:
    """Returns the exit status if a signal such as Ctrl-C caused an error; None for all other errors."""
    # Within a compiled kernel, the error of a signal becomes a SystemError.
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return status_of(cause)
        if isinstance(cause, SystemExit) and isinstance(error, SystemError) and isinstance(cause.code, int):
            return cause.code
        cause = cause.__cause__ or cause.__context__
    return None


def _parse(arguments: list[str]) -> Any:
    """Parses the command-line arguments after the program name into the options of a subcommand.

    Raises:
        InvalidValueError: If the first word is not a subcommand, or an argument is empty.
        SystemExit: If help was printed, or a later word cannot be parsed.
    """
    if arguments[0] not in VERBS and not arguments[0].startswith("--tyro-"):
        raise InvalidValueError(unknown_verb(arguments[0]))
    for index, word in enumerate(arguments):
        if not word or (word.startswith("--") and word.endswith("=")):  # an empty path would be the current folder
            where = f"after {arguments[index - 1]}" if not word else f"of {word[:-1]}"
            raise InvalidValueError(f"the argument {where} is empty: is a variable of the shell not set?")
    from splatwire.cli import _parsing  # imports tyro

    with _help_output(arguments):
        if arguments[0] in VERBS:
            return _parsing.parse_verb(arguments[0], arguments[1:])
        return _parsing.parse_any(arguments)


@contextmanager
def _help_output(arguments: Sequence[str]) -> Iterator[None]:
    """Context in which help texts and errors of the option parser tyro can be printed.

    They are at least `_MIN_COLUMNS` wide, and are discarded if standard output is closed. Control characters in
    arguments, such as names of files, and in a configuration file are escaped.
    """
    with contextlib.ExitStack() as stack:
        if shutil.get_terminal_size().columns < _MIN_COLUMNS:
            stack.enter_context(_environment("COLUMNS", str(_MIN_COLUMNS)))  # tyro would break lines without end
        if any(printable(word) != word or word.startswith("--config") for word in arguments):
            stack.enter_context(_environment("TERM", "dumb"))  # else the colours of tyro would be escaped, too
            stack.enter_context(printable_streams())
        if sys.stdout is None:  # tyro needs a stream
            nowhere = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
            stack.enter_context(contextlib.redirect_stdout(nowhere))
        yield


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    """Sets an environment variable until the end of the context."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _execute(verb: str, command: Any) -> None:
    """Checks that the output of a subcommand can be written, and runs the subcommand."""
    # `_run_MODULE` is imported only here, because its libraries would delay `--help`.
    from splatwire.cli._files import check_output  # imports numpy

    check_output(command)
    importlib.import_module(f"splatwire.cli._run_{VERBS[verb].module}").run(command)


def _print_error(message: str) -> int:
    print_failure(one_line(with_final_names(message)))
    return 2
