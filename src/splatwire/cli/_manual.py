"""Manual page `splatwire(1)`, made from the help of all subcommands."""

import contextlib
import io
import os
import re
from collections.abc import Iterator

from splatwire.cli import _parsing
from splatwire.cli._verbs import DESCRIPTION, VERBS
from splatwire.version import __version__

COLUMNS = 78
"""Width of the help of a verb in the page, characters; terminals are at least 80 wide."""


def manual_page() -> str:
    """Returns the manual page in the language of man(7)."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield f'.TH SPLATWIRE 1 "" "splatwire {__version__}" "User Commands"'
    yield ".SH NAME"
    yield r"splatwire \- codec and streaming of 3D Gaussian splats"
    yield ".SH SYNOPSIS"
    yield r".B splatwire"
    yield r"VERB [options]"
    yield ".SH DESCRIPTION"
    for paragraph in DESCRIPTION.splitlines():
        yield _escaped(paragraph) if paragraph else ".PP"
    yield ".SH VERBS"
    for name, verb in VERBS.items():
        yield from (".TP", rf".B {name}", _escaped(verb.help))
    for name in VERBS:
        yield f'.SH "SPLATWIRE {name.upper()}"'
        yield ".nf"
        yield from _help_lines(name)
        yield ".fi"
    yield ".SH EXIT STATUS"
    yield "0 on success, 2 for an error, 3 if data are missing or damaged, 130 after Ctrl\\-C, 143 after SIGTERM."
    yield "Verbs that run until they are stopped, such as serve, exit with 0 after both signals."


def _help_lines(verb: str) -> Iterator[str]:
    """Yields the help text of a subcommand without the frames around option groups."""
    text = io.StringIO()
    with _plain_terminal(), contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        _parsing.parse_verb(verb, ["--help"])
    for line in text.getvalue().strip().splitlines():
        bare = re.sub(r"^[│╭╰] ?|[ ─]*[│╮╯]$", "", line).rstrip(" ─")
        if bare or not line.strip():
            yield _escaped(bare)


@contextlib.contextmanager
def _plain_terminal() -> Iterator[None]:
    """Context in which help texts are printed without colours, in lines of `COLUMNS` characters.

    Sets environment variables that the option parser tyro reads, and restores them at the end.
    """
    before = dict(os.environ)
    os.environ.update(COLUMNS=str(COLUMNS), NO_COLOR="1", TERM="dumb")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _escaped(text: str) -> str:
    r"""Returns text for man(7): `\` and `-` are escaped, and no line begins with a control character."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-").replace("•", r"\[bu]")
    return rf"\&{escaped}" if escaped[:1] in (".", "'") else escaped
