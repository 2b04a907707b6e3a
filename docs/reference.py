"""Pages that are made from the code when the site is built: the command line's help, and the rooms' public names."""

import contextlib
import importlib
import io
import os
from collections.abc import Iterator

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from splatwire.cli.main import VERBS, main

ROOMS = (
    "scene", "model", "packets", "channel", "codec", "conceal", "render", "metrics", "data", "train", "evaluate",
    "transport", "view",
)  # fmt: skip
"""Rooms with a public face, in the order of the journey."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that `nav` names; called by MkDocs."""
    for path, content in (("reference/cli.md", _command_line()), ("reference/python.md", _python())):
        files.append(File.generated(config, path, content="".join(content)))
    return files


def _command_line() -> Iterator[str]:
    yield "# Command line\n\nEvery verb reads one thing, writes one thing, and has `--json`.\n"
    yield "`-` is standard input or output.\n"
    for verb in VERBS:
        yield f"\n## splatwire {verb}\n\n```text\n{_help(verb)}\n```\n"


def _help(verb: str) -> str:
    """What `splatwire VERB --help` prints, 100 columns wide, without colours."""
    os.environ.update(COLUMNS="100", NO_COLOR="1", TERM="dumb")
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main([verb, "--help"])
    return text.getvalue().strip()


def _python() -> Iterator[str]:
    yield "# Python\n\nThe names that a program uses; `import splatwire` has the most common ones.\n\n"
    for room in ROOMS:
        module = importlib.import_module(f"splatwire.{room}")
        yield f"\n## splatwire.{room}\n\n{(module.__doc__ or '').strip()}\n\n"
        for name in sorted(n for n in module.__all__ if not n.startswith("_")):
            home = getattr(getattr(module, name), "__module__", module.__name__)
            if home.startswith("splatwire.") and not isinstance(getattr(module, name), (dict, int, str)):
                yield f"::: {home}.{name}\n    options:\n      heading_level: 3\n\n"
