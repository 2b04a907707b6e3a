"""Names, messages and files cannot control the terminal, and JSON stays JSON."""

import ast
import contextlib
import io
import json
import os
import re
import subprocess
import sys
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import pytest

import splatwire.cli
from splatwire.cli import _rich, main
from splatwire.cli._output import print_summary, progress_bars
from splatwire.cli._rich import console, print_table
from splatwire.cli._table import print_rows
from splatwire.cli._terminal import PrintableStream, one_line, printable, printable_streams
from splatwire.errors import InvalidValueError

EVIL = "a\x1b[2J\x1b]0;title\x07\x9b31m\r\x08\x7f\u202egnp.exe\u2066\u200b\ufeff\u2028\udcff\x00z"
"""Sequences for screen and title, C1, carriage return, backspace, bidirectional overrides, a lone surrogate and more.
"""
GOOD = "plan à 東京\u3000Größe żółć עברית 👍 ±3 → “x”"


def controls(text: str, kept: str = "\n\t") -> list[str]:
    return [c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") and c not in kept]


@pytest.mark.slow
def test_terminal_control_characters_are_made_visible():
    assert printable(GOOD) == GOOD
    assert printable("two\nlines\t") == "two\nlines\t"
    assert printable("\x1b[2J\u202e\x9b") == "\\x1b[2J\\u202e\\x9b"
    assert not controls(printable(EVIL))
    assert not controls(printable("".join(map(chr, range(0x110000)))))
    assert one_line("a\r\n\n b\x1b") == "a b\\x1b"
    assert printable(EVIL).encode("utf-8").startswith(b"a\\x1b[2J")


def test_output_inside_the_context_is_printable(capsys):
    with printable_streams():
        print(EVIL, file=sys.stdout)
        print(EVIL, file=sys.stderr)
        sys.stdout.writelines([EVIL, EVIL])
        print_summary(EVIL)
    shown = capsys.readouterr()
    assert "\\x1b" in shown.out
    assert "\\x1b" in shown.err
    assert not controls(shown.out + shown.err)
    print("\x1b[1m")
    assert capsys.readouterr().out == "\x1b[1m\n"


def test_stream_attributes_and_bytes_are_unchanged():
    raw = io.BytesIO()
    stream = PrintableStream(io.TextIOWrapper(raw, "utf-8"))
    stream.buffer.write(b"\x1b\x00")
    assert stream.encoding == "utf-8"
    assert not stream.isatty()
    stream.flush()
    assert raw.getvalue() == b"\x1b\x00"


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


@contextlib.contextmanager
def at_a_terminal() -> Iterator[Terminal]:
    found = Terminal()
    with (
        patch.dict(os.environ, {"TERM": "xterm-256color"}),
        contextlib.redirect_stdout(found),
        contextlib.redirect_stderr(found),
    ):
        os.environ.pop("NO_COLOR", None)
        yield found


def own_sequences(text: str) -> str:
    """Removes the control sequences that rich writes: colours, and cursor movements of progress bars."""
    return re.sub(r"\x1b\[(\?25[lh]|[0-9;]*m|[12]?[KAG]|1A|2K)", "", text)


def test_terminal_tables_have_colours_and_no_control_characters():
    row = {
        "method": f"{EVIL}[red]x[/red][link=https://evil.example]y[/link]", "psnr": 30.0, "exact": False, "ssim": 0.9,
        "lpips": None, "num_lost": 3, "num_bytes": 10, "seconds": 1.0, "parts": {EVIL: 3}, "metrics": {"psnr": None},
    }  # fmt: skip
    with at_a_terminal() as terminal, printable_streams():
        print_rows([row], EVIL, lpips_note=EVIL)
    shown = terminal.getvalue()
    assert "\x1b[1;32m" in shown, "the best row is bold and green"
    assert "\x1b]" not in shown
    assert "[red]" in re.sub(r"\s", "", own_sequences(shown))
    assert not controls(own_sequences(shown))


def test_infinite_means_are_explained(capsys):
    """Of several seeds or views, one lost nothing that is visible."""
    row = {
        "method": "drop", "psnr": None, "exact": False, "ssim": 0.9, "lpips": None, "num_lost": 3, "num_bytes": 10,
        "seconds": 1.0, "parts": {}, "metrics": {},
    }  # fmt: skip
    print_rows([row], "a title", lpips_note="")
    shown = " ".join(capsys.readouterr().out.split())
    assert "│ infinite │" in shown
    assert "PSNR is infinite if" in shown


def test_progress_shows_names_without_control_characters():
    with at_a_terminal() as terminal:
        with printable_streams(), progress_bars() as report:
            report(EVIL, 0.5)
            print(EVIL, file=sys.stderr)
            print(EVIL)
            report(EVIL, 1.0)
        assert sys.stdout is terminal
    shown = own_sequences(terminal.getvalue())
    assert "\\x1b[2J" in shown
    assert not controls(shown.replace("\r", ""))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudoterminals")
def test_colorama_shows_no_escaped_sequence_at_exit() -> None:
    pytest.importorskip("colorama", reason="the package colorama is not installed")
    import pty

    code = "import colorama\nfrom splatwire.cli._terminal import printable_streams\n"
    code += "with printable_streams():\n    colorama.init()\n    print('shown')"
    ours, theirs = pty.openpty()
    with subprocess.Popen([sys.executable, "-c", code], stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # Linux reports the end of the terminal as an error
            while data := os.read(ours, 1000):
                shown += data
    os.close(ours)
    assert (process.returncode, shown.split()) == (0, [b"shown"])


def test_errors_are_one_line_without_control_characters(run, tmp_path):
    path = tmp_path / "x\x1b[2J\u202e\nsecond.swz"
    path.write_bytes(b"nothing")
    for words in (("inspect", path), ("decode", path, "-o", tmp_path / "o.ply"), ("inspect", f"{path}.gone")):
        outcome = run(*words)
        assert outcome.status != 0
        assert not controls(outcome.err)
        assert outcome.err.count("\n") == 1
        assert "\\x1b[2J\\u202e" in outcome.err


def test_usage_errors_show_no_control_characters_of_file_names(run, tmp_path):
    """As `inspect *` in a folder of somebody else."""
    name, config = "x\x1b[2J\u202e.swz", tmp_path / "serve.toml"
    config.write_text(r'log-level = "\u001b[2J\u202e"')
    usages = (
        ("inspect", "a.swz", name),
        ("serve", "a.swz", "--log-level", name),
        ("serve", "a.swz", "--config", config),
        ("serve", "a.swz", f"--config={config}"),
    )
    for words in usages:
        outcome = run(*words)
        assert outcome.status == 2
        assert not controls(outcome.err)
        assert "\\x1b[2J\\u202e" in outcome.err


def test_metadata_is_shown_without_control_characters(run, tmp_path, monkeypatch):
    from splatwire.cli import _run_inspect as module

    content = {"kind": EVIL, "writer": EVIL, EVIL: {"a": EVIL, EVIL: [EVIL, EVIL]}}
    monkeypatch.setattr(module, "describe", lambda path: content)
    path = tmp_path / "name[red].swz"
    path.write_bytes(b"")
    shown = run("inspect", path).out
    assert not controls(shown)
    assert "\\u202e" in shown
    assert json.loads(run("inspect", path, "--json").out) == json.loads(json.dumps(content))


def test_internal_error_prints_a_traceback_without_control_characters():
    code = (
        "import sys\nfrom splatwire.cli import main, _run_inspect\n"
        f"def run(command): raise RuntimeError({EVIL!r})\n"
        "_run_inspect.run = run\nsys.argv = ['splatwire', 'inspect', 'x']\nmain.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    shown = done.stderr.decode("utf-8")
    assert done.returncode == 1
    assert "RuntimeError: a\\x1b[2J" in shown
    assert not controls(shown)


def test_every_console_is_created_in_one_function():
    """A console that is created elsewhere would print untrusted text unchanged."""
    found = []
    for path in Path(splatwire.cli.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.ImportFrom) and node.module else []
            if "Console" in names:
                found.append(path.name)
    assert found == [Path(_rich.__file__).name]


def test_closed_standard_stream_is_not_wrapped(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", None)
    with printable_streams():
        assert sys.stdout is None
        print("x", file=sys.stderr)
    assert capsys.readouterr().err == "x\n"


def test_messages_of_the_command_line_are_one_line(capsys):
    assert main._print_error(str(InvalidValueError(f"{EVIL}\nsplatwire: all is well"))) == 2
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert not controls(shown)


def test_console_bypasses_the_wrapped_streams():
    with at_a_terminal() as terminal, printable_streams(), printable_streams():
        assert console().file is terminal
        print_table("a[red]b\x1b")
    assert own_sequences(terminal.getvalue()).strip() == "a[red]b\\x1b"
