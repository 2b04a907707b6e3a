import subprocess
import sys

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


def test_our_own_slips_keep_their_traceback(monkeypatch):
    """Only errors raised on purpose are shortened: a bug must stay visible."""

    class Failing:
        def run(self) -> None:
            raise ZeroDivisionError

    monkeypatch.setattr(main_module, "_parse", lambda arguments: Failing())
    with pytest.raises(ZeroDivisionError):
        main_module.main(["demo"])
