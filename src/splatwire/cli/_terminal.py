"""Safe output to a terminal: control characters are escaped.

Names of files and streams, messages of servers and contents of files are untrusted.
"""

import atexit
import contextlib
import os
import sys
import unicodedata
from collections.abc import Iterator
from typing import Any

_KEPT = "\n\t"
"""Control characters that are not escaped: line feed and tab."""


def printable(text: str) -> str:
    """Replaces each character that may control a terminal by a visible escape sequence."""
    # These are control characters (C0 but for line feed and tab, and C1), format characters such as bidirectional
    # overrides and zero-width characters, line and paragraph separators, lone surrogates, and unassigned characters.
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if _is_harmless(c) else _escaped(c) for c in text)


def one_line(text: str) -> str:
    """Returns a printable text in one line; white space becomes single spaces."""
    return printable(" ".join(text.split()))


def _is_harmless(character: str) -> bool:
    return character.isprintable() or character in _KEPT or unicodedata.category(character) == "Zs"


def _escaped(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


class PrintableStream:
    """Text stream that escapes terminal control characters.

    Bytes written to the attribute `buffer` are not escaped.

    Args:
        target: Stream that receives the escaped text.
    """

    def __init__(self, target: Any) -> None:
        self.target = target

    def write(self, text: str) -> int:
        """Writes a text with escaped control characters, and returns the length of the text."""
        self.target.write(printable(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Writes several texts, with control characters escaped."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.target, name)


class _ErrorStream(PrintableStream):
    """Standard error that discards texts if its reader has exited or its disk is full, instead of raising an error."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except BlockingIOError:  # full for now; later texts may pass
            return len(text)
        except OSError:
            discard_stderr()
            return len(text)

    def flush(self) -> None:
        try:
            self.target.flush()
        except BlockingIOError:
            pass
        except OSError:
            discard_stderr()


@contextlib.contextmanager
def printable_streams() -> Iterator[None]:
    """Makes standard output and standard error escape control characters."""
    with contextlib.ExitStack() as stack:
        if sys.stdout is not None:
            stack.enter_context(contextlib.redirect_stdout(PrintableStream(sys.stdout)))
        if sys.stderr is not None:
            stack.enter_context(contextlib.redirect_stderr(_ErrorStream(sys.stderr)))
        stack.callback(_forget_colorama)
        yield


def _forget_colorama() -> None:
    """Removes the exit function of colorama, which would write a control sequence to the stream that escapes it.

    numba initialises colorama, if it is installed.
    """
    module = sys.modules.get("colorama.initialise")
    if module is not None:
        atexit.unregister(module.reset_all)


def print_failure(text: str) -> None:
    """Prints an error on standard error; does nothing if nothing can be written there."""
    try:
        print(f"splatwire: error: {text}", file=sys.stderr)
    except OSError:
        discard_stderr()


def discard_stderr() -> None:
    """Redirects standard error to the null device, because Python would otherwise report an error when it exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
