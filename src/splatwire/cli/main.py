"""Dispatch: which verb runs, and how an error is told."""

import atexit
import contextlib
import gc
import importlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import tyro

import splatwire
from splatwire.cli._former import answer_former_words
from splatwire.cli._help import tell
from splatwire.cli._left_out import input_warnings
from splatwire.cli._output import DAMAGED
from splatwire.cli._resources import resource_problem
from splatwire.cli._terminal import one_line, printable_streams
from splatwire.cli._waiting import telling_why_it_takes_long
from splatwire.errors import SplatwireError, how_to_install

VERBS = {
    "demo": "demo.Demo",
    "train": "train.Train",
    "calibrate": "calibrate.Calibrate",
    "import": "import_model.Import",
    "export": "export.Export",
    "encode": "encode.Encode",
    "inspect": "inspect.Inspect",
    "transmit": "transmit.Transmit",
    "plan": "plan.PlanCommand",
    "serve": "serve.Serve",
    "live": "live.Live",
    "receive": "receive.Receive",
    "pack": "pack.Pack",
    "view": "view.View",
    "verify": "verify.Verify",
    "decode": "decode.Decode",
    "render": "render.Render",
    "evaluate": "evaluate.Evaluate",
    "study": "study.StudyCommand",
}
"""Verb to file and settings class; each class has a `run()`."""

_OBJECTS = 200_000
"""So many more objects than were given up are made before garbage is looked for."""
_DESCRIPTION = """Carries 3D Gaussian splats across lossy networks.

`splatwire demo` shows it; `splatwire VERB --help` tells what a verb takes.
`splatwire --version` tells the version.
`splatwire --tyro-print-completion bash` (zsh, tcsh) prints a shell's completion.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits.

    The exit status is 0, or 2 for a mistake that one line on standard error explains, or 3 if the result comes from a
    damaged input or an incomplete transfer, or 130 after Ctrl-C (143 when the process was ended by SIGTERM).

    Args:
        arguments: Words after the program's name; None for those of the process.
    """
    # Before any library starts OpenMP: its threads spin while they wait, which on busy processors costs others their
    # turn and the work itself several times its length.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    if arguments is None:
        sys.excepthook = _print_traceback
    try:
        with _standard_streams(), _ended_in_order(), _few_collections():
            status = _run(list(sys.argv[1:] if arguments is None else arguments))
            status = _flushed(status)
    except BrokenPipeError:  # whoever read the output has gone, e.g. `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status)


def _print_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    with printable_streams():
        traceback.print_exception(kind, error, trace)


def _flushed(status: int) -> int:
    """Writes what standard output holds back; returns the exit status.

    Raises:
        BrokenPipeError: If nobody reads it.
    """
    if sys.stdout is None:
        return status
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else it is tried again at the end
        return _complain(f"standard output: {resource_problem(error) or error}")
    return status


@contextmanager
def _standard_streams() -> Iterator[None]:
    """Gives errors somewhere to go where standard error is closed; `print` would take standard output instead."""
    if sys.stderr is not None:
        yield
        return
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stderr(nowhere):
        yield


@contextmanager
def _few_collections() -> Iterator[None]:
    """Has garbage looked for seldom: libraries make half a million objects as they load, none of which is any.

    Looking after each seven hundred takes a sixth of the time that a verb needs to begin, and looking at the end, as
    Python does twice, a tenth more.
    """
    atexit.register(gc.freeze)
    before = gc.get_threshold()
    gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Makes a polite end of the process (`kill`, a closed terminal) an exit, so that unfinished files are removed."""

    def end(number: int, _: object) -> None:
        sys.exit(128 + number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [n for n in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)) if _is_default(n)]
    before = {number: signal.signal(number, end) for number in dict.fromkeys(numbers)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _is_default(number: int) -> bool:
    return signal.getsignal(number) is signal.SIG_DFL  # not what `nohup` ignores


def _run(arguments: list[str]) -> int:
    try:
        if arguments in (["--version"], ["-V"]):
            print(f"splatwire {splatwire.__version__}")
            return 0
        verb = _parse(arguments)
        waits = telling_why_it_takes_long(arguments[0] if arguments else "")
        with printable_streams(), waits, input_warnings() as warnings:
            verb.run()
    except BrokenPipeError:
        raise
    except (Exception, KeyboardInterrupt) as error:
        if _is_interruption(error):
            print("splatwire: stopped", file=sys.stderr)
            return 130
        if isinstance(error, SplatwireError):
            return _complain(str(error))
        if problem := resource_problem(error):
            return _complain(problem)
        if isinstance(error, OSError):
            return _complain(str(error))
        if isinstance(error, ModuleNotFoundError) and (how := how_to_install(error.name)):
            return _complain(how)
        raise
    return _complain_of_damage(verb) if warnings.damaged else 0


def _complain_of_damage(verb: Any) -> int:
    """Prints that a result is partial; returns the exit status."""
    if getattr(verb, "accept_damage", False):
        return 0
    how = ", or accept this result with --accept-damage" if hasattr(verb, "accept_damage") else ""
    print(
        f"splatwire: error: the input is damaged, and only its intact parts were used: fetch it again{how}",
        file=sys.stderr,
    )
    return DAMAGED


def _is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: while a compiled kernel runs, it comes out as a SystemError of the kernel."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _parse(arguments: list[str]) -> Any:
    """Reads the words; only the chosen verb's file is imported, unless an overview is asked for."""
    config = (
        tyro.conf.FlagCreatePairsOff,
        tyro.conf.OmitArgPrefixes,
        tyro.conf.OmitSubcommandPrefixes,
        tyro.conf.DisallowNone,
    )
    if arguments and arguments[0] in VERBS:
        verb = arguments[0]
        answer_former_words(verb, arguments[1:])
        return tyro.cli(settings_of(verb), prog=f"splatwire {verb}", args=arguments[1:], config=config)
    verbs = {verb: settings_of(verb) for verb in VERBS}
    return tyro.extras.subcommand_cli_from_dict(
        verbs, prog="splatwire", description=_DESCRIPTION, args=arguments or ["--help"], config=config
    )


def settings_of(verb: str) -> Any:
    """The settings class of a verb; only its file is imported."""
    module, name = VERBS[verb].split(".")
    settings = getattr(importlib.import_module(f"splatwire.cli.{module}"), name)
    tell(settings)
    return settings


def _complain(message: str) -> int:
    print(f"splatwire: error: {one_line(message)}", file=sys.stderr)
    return 2
