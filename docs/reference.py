"""Pages that are made from the code when the site is built: help of the command line, and public names of packages."""

import contextlib
import importlib
import inspect
import io
import os
import pkgutil
from collections.abc import Iterable, Iterator
from types import ModuleType

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from splatwire.cli.main import VERBS, main

PACKAGES = (
    "api.coding", "api.scoring", "api.network",
    "io", "types", "data", "neural.training", "neural.training.gaussians", "neural.importers", "io.formats",
    "anchors", "codec", "bitstream",
    "channel", "concealment", "concealment.temporal", "paper", "render", "metrics", "evaluation", "evaluation.study",
    "anchors.export", "calibration", "planning", "rate_control", "finetuning", "sequence", "lod",
    "transport", "transport.protocol", "transport.http", "view",
)  # fmt: skip
"""Packages with public names, in the order of their pages."""


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
    """Returns the output of `splatwire VERB --help`, 100 columns wide, without colours."""
    os.environ.update(COLUMNS="100", NO_COLOR="1", TERM="dumb")
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main([verb, "--help"])
    return text.getvalue().strip()


def _python() -> Iterator[str]:
    yield "# Python\n\nThe names that a program uses; `import splatwire` has the most common ones.\n\n"
    for package in PACKAGES:
        module = importlib.import_module(f"splatwire.{package}")
        yield f"\n## splatwire.{package}\n\n{(module.__doc__ or '').strip()}\n\n"
        for home, name in public_names(module):
            yield f"::: {home}.{name}\n    options:\n      heading_level: 3\n\n"


def public_names(package: ModuleType) -> list[tuple[str, str]]:
    """Returns the public classes and functions of a package, each with its module.

    These are the exported names; of a package that exports nothing, the names of its modules.
    """
    found = _names_in(package, getattr(package, "__all__", vars(package)))
    if not found:
        files = [file.name for file in pkgutil.iter_modules(package.__path__) if not file.name.startswith("_")]
        modules = [importlib.import_module(f"{package.__name__}.{file}") for file in files]
        found = [
            entry for module in modules for entry in _names_in(module, vars(module)) if entry[0] == module.__name__
        ]
    return found


def _names_in(module: ModuleType, names: Iterable[str]) -> list[tuple[str, str]]:
    values = {name: getattr(module, name) for name in sorted(names) if not name.startswith("_")}
    shown = {name: value for name, value in values.items() if inspect.isclass(value) or inspect.isfunction(value)}
    return [(value.__module__, name) for name, value in shown.items() if value.__module__.startswith("splatwire.")]
