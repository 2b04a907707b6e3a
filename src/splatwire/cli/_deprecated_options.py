"""Former names of options: hidden aliases that work for one minor release, with a warning."""

import sys
from collections.abc import Mapping, Sequence

DEPRECATED_OPTIONS = {"plan": {"way-back": "feedback"}, "serve": {"side-repair": "init-repair"}}
"""For each verb: former option names and their replacements, both without leading dashes. Entries are removed after one
minor release."""


def with_current_names(verb: str, words: Sequence[str], renamed: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Replaces deprecated option names in the arguments of a subcommand, with a warning for each.

    Args:
        verb: Name of the subcommand.
        words: Command-line arguments after the subcommand.
        renamed: Renamed options of each subcommand: a mapping from the former to the current name of an option.
    """
    names, current = renamed.get(verb, {}), []
    for word in words:
        name, equals, value = word.partition("=")
        former = name.removeprefix("--").replace("_", "-")
        if name.startswith("--") and former in names:
            now = f"--{names[former]}"
            print(
                f"splatwire: warning: --{former} is now {now}; the former name ends with the next release",
                file=sys.stderr,
            )
            word = f"{now}{equals}{value}"
        current.append(word)
    return current
