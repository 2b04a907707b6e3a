import itertools
import os
import re
import signal
import subprocess
import sys
import threading
import weakref
from typing import Any

import numba
import numpy as np
import pytest

import splatwire
from splatwire.bitstream.limits import MAX_GROUP_FRAMES
from splatwire.cli import _signals
from splatwire.cli import main as main_module
from splatwire.cli._deprecated_options import with_current_names
from splatwire.cli._parsing import settings_of
from splatwire.cli._signals import SignalErrors
from splatwire.cli.main import VERBS
from splatwire.sequence.options import GROUP_FRAMES


def test_help_names_every_verb(run):
    outcome = run("--help")
    assert outcome.status == 0
    assert all(verb in outcome.out for verb in VERBS)


def test_call_without_arguments_shows_the_overview(run):
    assert "demo" in run().out


CALIBRATIONS = ("gnn", "sketch", "preview")
COMMANDS = [(verb,) for verb in VERBS if verb != "calibrate"] + [("calibrate", name) for name in CALIBRATIONS]


@pytest.mark.parametrize("words", COMMANDS)
def test_every_verb_has_help_and_json(run, words):
    outcome = run(*words, "--help")
    assert outcome.status == 0
    assert "--json" in outcome.out


@pytest.mark.parametrize(
    ("words", "usage"),
    [
        (("apply",), "[-h] STREAM UPDATE -o STR"),
        (("export",), "[OPTIONS] FORMAT SCENE"),
        (("import",), "{hacpp,scaffold,splats} MODEL -o STR"),
        (("pack",), "[-h] SOURCE [SOURCE ...] -o STR"),
        (("serve",), "[OPTIONS] [STREAM ...]"),
        (("view",), "[OPTIONS] [STREAM]"),
    ],
)
def test_help_names_positional_arguments(run, words, usage):
    assert usage in run(*words, "--help").out.splitlines()[0]


def test_help_of_a_negative_flag_describes_the_flag(run):
    assert not re.search(r"--no-\w+[^-]*\(default: True\)", run("view", "--help").out)
    assert "Do not open the page in a browser" in run("view", "--help").out


def test_an_option_before_the_verb_is_refused_with_an_example(run):
    outcome = run("--verbose", "encode")
    assert outcome.status == 2
    assert "unknown option --verbose: the verb comes first" in outcome.err


@pytest.mark.parametrize("words", COMMANDS)
def test_help_fits_a_narrow_terminal(run, words, monkeypatch):
    """Numbers are not broken at a comma, lines are filled, and no default is shown as None."""
    monkeypatch.setenv("COLUMNS", "80")
    help_text = run(*words, "--help").out
    assert "None" not in help_text
    assert not re.search(r"\d,\s*│\n│\s+\d", help_text)
    lines = [line[1:-1].strip() for line in help_text.splitlines() if line.startswith("│")]
    for line, after in itertools.pairwise(lines):
        option = after.startswith(("-", "─")) or line.startswith(("-", "─")) or not after
        assert option or line.endswith((".", ")")) or len(line) + len(after.split()[0]) > 45, line


@pytest.mark.parametrize("verb", ["encode", "live"])
def test_help_states_the_default_gop_length(run, verb, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert re.search(rf"\(GOP\), 1 to {MAX_GROUP_FRAMES} frames, default {GROUP_FRAMES}\.", run(verb, "--help").out)


def test_overview_mentions_version_and_completion(run):
    help_text = run("--help").out
    assert "--version" in help_text
    assert "--tyro-print-completion" in help_text
    assert "complete" in run("--tyro-print-completion", "bash").out


def test_version_is_printed(run):
    assert run("--version").out == f"splatwire {splatwire.__version__}\n"


def test_unknown_verb_is_a_usage_error(run):
    outcome = run("teleport")
    assert outcome.status == 2
    assert outcome.out == ""
    assert "teleport" in outcome.err
    assert "receive" in run("qqqq").err


def test_misspelt_verb_error_suggests_similar_verbs(run):
    outcome = run("inspekt", "x.swz")
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1
    assert "did you mean inspect?" in outcome.err


@pytest.mark.parametrize("verb", VERBS)
def test_the_overview_has_the_first_paragraph_of_each_docstring(verb):
    first = settings_of(verb).__doc__.partition("\n\n")[0]
    assert VERBS[verb].help == " ".join(first.split())


@pytest.mark.parametrize("columns", ["40", "80", "200"])
def test_the_overview_fits_the_terminal(run, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    verbs = run("--help").out.partition("verbs:")[2]
    assert max(map(len, verbs.splitlines())) <= int(columns)


def test_a_renamed_option_works_under_its_former_name_with_a_warning(capsys):
    renamed = {"encode": {"old-size": "block-size"}}
    words = ["x.ply", "--old-size", "60", "--old_size=7", "-o", "old-size", "--lanes", "2"]
    now = with_current_names("encode", words, renamed)
    assert now == ["x.ply", "--block-size", "60", "--block-size=7", "-o", "old-size", "--lanes", "2"]
    warned = capsys.readouterr().err.splitlines()
    assert len(warned) == 2
    assert all("--old-size is now --block-size" in line for line in warned)
    assert with_current_names("decode", words, renamed) == words


def test_help_loads_no_heavy_library():
    """The overview is printed from the table of verbs: no verb's module is imported."""
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'numba', 'scipy', 'matplotlib', 'numpy', 'tyro', 'rich', 'asyncio'} & set(sys.modules)\n"
        "heavy |= {name for name in sys.modules if name.startswith('splatwire.cli.') and '._' not in name}\n"
        "heavy -= {'splatwire.cli.main'}\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (splatwire.SplatwireError("two\nlines"), 2, "splatwire: error: two lines\n"),
        (OSError(28, "No space left on device"), 2, "No space left on device"),
        (KeyboardInterrupt(), 130, "splatwire: stopped\n"),
    ],
)
def test_errors_are_one_line_without_traceback(run, monkeypatch, error, status, words):
    def fail(verb, options):
        raise error

    monkeypatch.setattr(main_module, "_execute", fail)
    outcome = run("demo")
    assert outcome.status == status
    assert words in outcome.err
    assert outcome.err.count("\n") == 1
    assert outcome.out == ""


def _python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_ctrl_c_while_the_command_line_loads_is_one_error_line():
    done = _python(
        "import splatwire.__main__ as entry\n"
        "class Loader:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'splatwire.cli.main':\n"
        "            raise KeyboardInterrupt\n"
        "entry.sys.meta_path.insert(0, Loader())\n"
        "entry.start()"
    )
    assert (done.returncode, done.stderr) == (130, "splatwire: stopped\n")


def test_ctrl_c_after_the_end_of_a_command_prints_no_traceback():
    done = _python(
        "import atexit, os, signal, sys\nimport splatwire.__main__ as entry\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # may be ignored where tests run
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        "sys.argv = ['splatwire', '--version']\nentry.start()"
    )
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
    assert done.stdout.startswith("splatwire ")


def test_ctrl_c_while_the_last_output_is_flushed_prints_no_traceback():
    """A reader that pauses, such as a pager, makes a command wait there."""
    done = _python(
        "import io, os, signal, sys\nimport splatwire.__main__ as entry\n"
        "class Output(io.TextIOWrapper):\n"
        "    def flush(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        super().flush()\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "sys.stdout = Output(sys.stdout.buffer, errors='backslashreplace')\n"
        "sys.argv = ['splatwire', '--version']\nentry.start()"
    )
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_handler_of_ctrl_c_that_is_not_pythons_stays(run, monkeypatch):
    monkeypatch.setattr(signal, "getsignal", lambda _: None)
    assert run("--version").status == 0


@pytest.mark.parametrize("width", ["5", None])
def test_help_in_a_narrow_terminal_leaves_the_environment(run, monkeypatch, width):
    monkeypatch.delenv("COLUMNS", raising=False)
    if width is None:
        monkeypatch.setattr(main_module.shutil, "get_terminal_size", lambda *_: os.terminal_size((5, 24)))
    else:
        monkeypatch.setenv("COLUMNS", width)
    assert run("pack", "--help").status == 0
    assert os.environ.get("COLUMNS") == width


@pytest.mark.parametrize(
    ("module", "function"),
    [
        ("llvmlite.binding.executionengine", "callback"),
        ("elsewhere", "__del__"),
        ("weakref", "remove"),
        ("numba.core.compiler_lock", "release"),
        ("contextlib", "__exit__"),
    ],
)
def test_ctrl_c_waits_while_an_error_would_be_lost(module, function):
    """LLVM and Python ignore errors of callbacks; after an error inside a lock, the lock could stay locked."""
    code = (
        f"def {function}():\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    for _ in range(1000):\n"
        "        pass\n"
        "    done.append(True)\n"
    )
    values: dict[str, Any] = {"__name__": module, "os": os, "signal": signal, "done": []}
    exec(code, values)

    given_up = threading.Event()

    def interrupted() -> None:
        values[function]()
        given_up.wait()  # the repeated signal interrupts the wait

    before = signal.signal(signal.SIGINT, SignalErrors(lambda _: KeyboardInterrupt()).handle)
    timeout = threading.Timer(240, given_up.set)
    timeout.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        timeout.cancel()
        signal.signal(signal.SIGINT, before)
    assert values["done"] == [True]
    assert not given_up.is_set()


def test_ctrl_c_in_a_callback_that_loses_errors_is_repeated(capsys):
    """Python prints and ignores errors of any function that it calls while it frees an object."""

    class Held:
        pass

    def freed(_: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass

    given_up = threading.Event()

    def interrupted() -> None:
        held = Held()
        weakref.ref(held, freed)
        watched = weakref.ref(held, freed)
        del held
        assert watched() is None
        given_up.wait()  # the repeated signal interrupts the wait

    errors = SignalErrors(lambda _: KeyboardInterrupt())
    before = signal.signal(signal.SIGINT, errors.handle)
    timeout = threading.Timer(240, given_up.set)
    timeout.start()
    try:
        with errors.lost_ones_repeated(), pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        timeout.cancel()
        signal.signal(signal.SIGINT, before)
    assert not given_up.is_set()
    assert capsys.readouterr().err == ""


def test_other_ignored_errors_are_printed(monkeypatch):
    printed: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: printed.append(unraisable.exc_type))

    class Broken:
        def __del__(self):
            raise ZeroDivisionError

    with SignalErrors(lambda _: KeyboardInterrupt()).lost_ones_repeated():
        Broken()
    assert printed == [ZeroDivisionError]


def test_a_second_signal_waits_until_the_command_has_cleaned_up(tmp_path, monkeypatch):
    """Users press Ctrl-C twice, and `timeout` sends SIGTERM to the group of a process that has just got it."""
    now = 100.0
    errors = SignalErrors(lambda number: SystemExit(128 + number), lambda: now)
    repeated: list[int] = []
    monkeypatch.setattr(_signals, "_repeat_later", repeated.append)
    with pytest.raises(SystemExit):
        errors.handle(signal.SIGTERM, None)
    for number in (signal.SIGTERM, signal.SIGINT):
        errors.handle(number, None)
    assert repeated == [signal.SIGTERM, signal.SIGINT]
    now += 3600.0  # cleaning hangs
    with pytest.raises(SystemExit) as stopped:
        errors.handle(signal.SIGINT, None)
    assert stopped.value.code == 130


def test_the_first_interrupt_is_only_reported_and_the_second_one_stops():
    reported = threading.Event()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with _signals.first_interrupt(reported.set):
            signal.raise_signal(signal.SIGINT)
            assert reported.wait(120)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_ignored_interrupt_stays_ignored_in_a_training():
    """A script's background job must not end at the Ctrl-C that is meant for another program."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with _signals.first_interrupt(lambda: None):
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("handler", [signal.SIG_DFL, signal.SIG_IGN, signal.default_int_handler])
def test_a_signal_that_waited_ends_with_its_command(handler, monkeypatch):
    sent: list[int] = []
    monkeypatch.setattr(signal, "pthread_kill", lambda _, number: sent.append(number))
    monkeypatch.setattr(signal, "getsignal", lambda _: handler)
    _signals._repeat(signal.SIGINT)
    assert not sent


def test_ctrl_c_stops_the_compilation_of_a_kernel():
    def callee() -> None:
        raise AssertionError("only the compiler replaces it")

    completed = []

    @numba.extending.overload(callee)
    def compiled():
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass
        completed.append(True)
        return lambda: None

    def compile_kernel() -> None:
        numba.njit(lambda: callee())()
        threading.Event().wait(60)  # ended by a late interrupt

    before = signal.signal(signal.SIGINT, SignalErrors(lambda _: KeyboardInterrupt()).handle)
    try:
        with pytest.raises(KeyboardInterrupt):
            compile_kernel()
    finally:
        signal.signal(signal.SIGINT, before)
    assert not completed
    assert not numba.core.compiler_lock.global_compiler_lock.is_locked()


def test_ctrl_c_in_a_kernel_is_one_error_line(run, monkeypatch):
    """numba raises SystemError for an interrupt in a kernel that returns an array."""

    def interrupted(verb, options):
        words = (os.getpid(), signal.SIGINT)
        timer = threading.Timer(0.2, os.kill, words)
        timer.start()
        while True:
            _long_kernel(np.ones(3), 60_000_000)

    _long_kernel(np.ones(3), 1)
    monkeypatch.setattr(main_module, "_execute", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell ignore the signal
    try:
        outcome = run("demo")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (outcome.status, outcome.out, outcome.err) == (130, "", "splatwire: stopped\n")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_polite_ends_in_a_kernel_keep_their_status(run, monkeypatch, number):
    def ended(verb, options):
        try:
            sys.exit(128 + number)
        except SystemExit as error:
            raise SystemError("a kernel returned a result with an exception set") from error

    monkeypatch.setattr(main_module, "_execute", ended)
    outcome = run("demo")
    assert (outcome.status, outcome.out, outcome.err) == (128 + number, "", "splatwire: stopped\n")


@numba.njit(nogil=True)  # lets the timer thread run meanwhile
def _long_kernel(values, count):
    total = 0.0
    for index in range(count):
        total += np.sin(values[index % len(values)])
    return np.full(3, total), total


@pytest.fixture
def default_signals():
    """Default actions of signals, also where the tests run with nohup, which ignores SIGHUP."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, action in before.items():
        signal.signal(number, action)


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_a_plug_in_is_loaded_is_no_error_of_it(run, monkeypatch, number):
    def ended(verb, options):
        try:
            signal.raise_signal(number)
        except (Exception, SystemExit):  # as the loader of plug-ins, which may raise anything
            raise ZeroDivisionError from None

    monkeypatch.setattr(main_module, "_execute", ended)
    outcome = run("demo")
    assert (outcome.status, outcome.out, outcome.err) == (128 + number, "", "splatwire: stopped\n")


def test_internal_errors_keep_their_traceback(monkeypatch):
    """Only deliberate errors are shortened; a bug must stay visible."""

    def fail(verb, options):
        raise ZeroDivisionError

    monkeypatch.setattr(main_module, "_execute", fail)
    with pytest.raises(ZeroDivisionError):
        main_module.main(["demo"])


def test_help_ends_in_a_terminal_of_any_width(run, monkeypatch):
    """Without a least width, the option parser breaks the lines of a narrow terminal without end."""
    for width in ("1", "5", "40"):
        monkeypatch.setenv("COLUMNS", width)
        shown = run("serve", "--help")
        assert (shown.status, "--quic" in shown.out) == (0, True)


def test_serve_help_marks_relay_options(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    lines = run("serve", "--help").out
    for option in ("--fingerprint", "--authority", "--insecure"):
        assert lines.partition(option)[2].partition("--moq")[0].count("--") == 0, option
    assert "With --moq only" in lines
