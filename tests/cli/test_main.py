import itertools
import os
import re
import signal
import subprocess
import sys
import threading

import numba
import numpy as np
import pytest

import splatwire
from splatwire.cli import main as main_module
from splatwire.cli.main import VERBS


def test_help_names_every_verb(run):
    outcome = run("--help")
    assert outcome.status == 0
    assert all(verb in outcome.out for verb in VERBS)


def test_without_words_the_overview_is_shown(run):
    assert "demo" in run().out


CALIBRATIONS = ("gnn", "sketch", "preview")
COMMANDS = [(verb,) for verb in VERBS if verb != "calibrate"] + [("calibrate", name) for name in CALIBRATIONS]


@pytest.mark.parametrize("words", COMMANDS)
def test_every_verb_has_help_and_json(run, words):
    outcome = run(*words, "--help")
    assert outcome.status == 0
    assert "--json" in outcome.out


@pytest.mark.parametrize("words", COMMANDS)
def test_help_fits_a_narrow_terminal(run, words, monkeypatch):
    """No number is cut at its comma, no line ends before it is full, and nothing is said to be None."""
    monkeypatch.setenv("COLUMNS", "80")
    told = run(*words, "--help").out
    assert "None" not in told
    assert not re.search(r"\d,\s*│\n│\s+\d", told)
    lines = [line[1:-1].strip() for line in told.splitlines() if line.startswith("│")]
    for line, after in itertools.pairwise(lines):
        option = after.startswith(("-", "─")) or line.startswith(("-", "─")) or not after
        assert option or line.endswith((".", ")")) or len(line) + len(after.split()[0]) > 45, line


def test_the_overview_tells_of_version_and_completion(run):
    told = run("--help").out
    assert "--version" in told
    assert "--tyro-print-completion" in told
    assert "complete" in run("--tyro-print-completion", "bash").out


def test_version(run):
    assert run("--version").out == f"splatwire {splatwire.__version__}\n"


def test_unknown_verb_is_a_usage_error(run):
    outcome = run("teleport")
    assert outcome.status == 2
    assert outcome.out == ""
    assert "teleport" in outcome.err


def test_help_loads_no_heavy_library():
    """A user who asks for help must not wait for torch."""
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'numba', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules)\n"
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
    class Failing:
        def run(self) -> None:
            raise error

    monkeypatch.setattr(main_module, "_parse", lambda arguments: Failing())
    outcome = run("demo")
    assert outcome.status == status
    assert words in outcome.err
    assert outcome.err.count("\n") == 1
    assert outcome.out == ""


def test_ctrl_c_in_a_kernel_is_one_line(run, monkeypatch):
    """numba makes a SystemError of it where a kernel returns an array."""

    class Interrupted:
        def run(self) -> None:
            words = (os.getpid(), signal.SIGINT)
            timer = threading.Timer(0.2, os.kill, words)
            timer.start()
            while True:
                _long_kernel(np.ones(3), 60_000_000)

    _long_kernel(np.ones(3), 1)
    monkeypatch.setattr(main_module, "_parse", lambda arguments: Interrupted())
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        outcome = run("demo")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (outcome.status, outcome.out, outcome.err) == (130, "", "splatwire: stopped\n")


@numba.njit(nogil=True)  # so that the timer's thread runs meanwhile
def _long_kernel(values, count):
    total = 0.0
    for index in range(count):
        total += np.sin(values[index % len(values)])
    return np.full(3, total), total


def test_our_own_slips_keep_their_traceback(monkeypatch):
    """Only errors raised on purpose are shortened: a bug must stay visible."""

    class Failing:
        def run(self) -> None:
            raise ZeroDivisionError

    monkeypatch.setattr(main_module, "_parse", lambda arguments: Failing())
    with pytest.raises(ZeroDivisionError):
        main_module.main(["demo"])


def test_serve_says_which_options_are_for_a_relay(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    lines = run("serve", "--help").out
    for option in ("--fingerprint", "--authority", "--insecure"):
        assert lines.partition(option)[2].partition("--moq")[0].count("--") == 0, option
    assert "With --moq only" in lines
