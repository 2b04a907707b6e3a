"""Parsing of command-line options with tyro."""

# The import of tyro takes 0.1 s; `splatwire --help` works without it.

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin

import tyro

from splatwire.cli._config_file import OPTION, config_path, with_flags, without_flags, words_of_file
from splatwire.cli._deprecated_options import DEPRECATED_OPTIONS, with_current_names
from splatwire.cli._help import set_help_texts
from splatwire.cli._verbs import DESCRIPTION, VERBS

_CONFIG = (
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.OmitArgPrefixes,
    tyro.conf.OmitSubcommandPrefixes,
    tyro.conf.DisallowNone,
)


def _skip_typeguard_import() -> None:
    """Makes the option parser tyro start faster: replaces its type check of option defaults by a simpler one."""
    # Importing typeguard, which tyro uses, takes long. A static type checker has already checked these defaults, so
    # that the items of tuples and lists can be ignored.
    resolver: Any = getattr(tyro, "_resolver", None)  # private: a release without it checks as before
    checked: Any = getattr(resolver, "is_instance", None)

    def is_instance(kind: Any, value: Any) -> Any:
        origin = get_origin(kind)
        if origin is UnionType:
            return any(is_instance(part, value) for part in get_args(kind))
        return isinstance(value, origin) if origin in (tuple, list) else checked(kind, value)

    if checked is not None:
        resolver.is_instance = is_instance


_skip_typeguard_import()


def parse_verb(verb: str, arguments: Sequence[str]) -> Any:
    """Parses the options of one subcommand.

    Args:
        verb: Name of the subcommand.
        arguments: Command-line arguments after the subcommand.

    Returns:
        Instance of the subcommand's options class.

    Raises:
        SystemExit: If help was printed, or a word cannot be parsed.
    """
    words = with_current_names(verb, arguments, DEPRECATED_OPTIONS)
    settings = settings_of(verb)
    if hasattr(settings, OPTION) and (path := config_path(words)) is not None:
        return _parse_with_file(verb, settings, words, path)
    return tyro.cli(settings, prog=f"splatwire {verb}", args=words, config=_CONFIG)


def _parse_with_file(verb: str, settings: Any, words: Sequence[str], path: Path) -> Any:
    """Parses the options of a subcommand from a configuration file and the command line, which takes precedence."""
    former = DEPRECATED_OPTIONS.get(verb, {})
    in_file = with_current_names(verb, words_of_file(path, settings, "streams", former), DEPRECATED_OPTIONS)
    configured = tyro.cli(settings, prog=f"splatwire {verb} --{OPTION} {path}:", args=in_file, config=_CONFIG)
    parsed = tyro.cli(
        settings, prog=f"splatwire {verb}", args=words, config=_CONFIG, default=without_flags(configured)
    )  # fmt: skip
    return with_flags(parsed, configured)


def parse_any(arguments: Sequence[str]) -> Any:
    """Parses arguments with the options of all subcommands, as required to generate shell completions.

    Args:
        arguments: Command-line arguments after the program name.

    Raises:
        SystemExit: If a completion was printed, or a word cannot be parsed.
    """
    verbs = {verb: settings_of(verb) for verb in VERBS}
    return tyro.extras.subcommand_cli_from_dict(
        verbs, prog="splatwire", description=DESCRIPTION, args=arguments, config=_CONFIG
    )


def settings_of(verb: str) -> Any:
    """Returns the options class of a subcommand, with help texts."""
    entry = VERBS[verb]
    settings = getattr(importlib.import_module(f"splatwire.cli.{entry.module}"), entry.settings)
    set_help_texts(settings)
    return settings
