"""Words that the command line had once, and what to say instead."""

from collections.abc import Sequence

from splatwire.errors import InvalidValueError

_STUDY = "protocols have a verb of their own: `splatwire study FILE.toml -o FOLDER --{}`"
_PACKETS = "--preset says which packets are made"
_OWN_STREAM = ("stream", "cameras", "background")
_FORMER = {
    "evaluate": {
        **{name: _STUDY.format(name) for name in ("engine", "workers", "scene", "photos", "weights")},
        "store": "finished work is kept in the folder store of what `splatwire study` writes",
        "data-root": "set the environment variable SPLATWIRE_DATA for `splatwire study`",
        "scene-name": "`splatwire study --scene FILE` calls the scene by the name of its file",
        "send-order": "`splatwire transmit` has it, and a protocol (`splatwire study`)",
    },
    "encode": {
        "seed": "refinement takes the seed 0",
        **dict.fromkeys(("lane-seed", "order"), _PACKETS),
        "grouping": f"{_PACKETS}; `evaluate --contiguous` compares contiguous packets",
    },
    "demo": dict.fromkeys(_OWN_STREAM, "`splatwire evaluate STREAM --reference STREAM` is for other streams"),
    "view": dict.fromkeys(("renderer", "background"), "the browser draws every stream"),
    "train": {"test-interval": "tests are made every 1,000 iterations and at the end"},
}
"""Verb, then option without its dashes, then the answer."""


def answer_former_words(verb: str, words: Sequence[str]) -> None:
    """Answers an option that a verb no longer has.

    Args:
        verb: The verb.
        words: What follows it.

    Raises:
        InvalidValueError: If there is such an option; the message says what to write instead.
    """
    for word in words:
        name = word.partition("=")[0].removeprefix("--").replace("_", "-")
        if word.startswith("--") and name in _FORMER.get(verb, {}):
            raise InvalidValueError(f"`splatwire {verb}` has no --{name} any more: {_FORMER[verb][name]}")
