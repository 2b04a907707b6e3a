"""Table of the subcommands of `splatwire`."""

# Only the module of the chosen subcommand is imported.

import difflib
import shutil
import textwrap
from typing import NamedTuple

DESCRIPTION = """Compresses 3D Gaussian splats, and streams them over networks that lose packets.

`splatwire demo` is an example; `splatwire VERB --help` lists the options of a verb.
`splatwire --version` prints the version.
`splatwire --tyro-print-completion bash` (or zsh) prints a shell's completion, `splatwire --manual` a manual page."""


class Verb(NamedTuple):
    """A subcommand of the command line.

    Attributes:
        module: Name of the module in `splatwire.cli` with the options class.
        settings: Name of the options class.
        help: First paragraph of the docstring of the options class.
    """

    module: str
    settings: str
    help: str


VERBS = {
    "demo": Verb(
        "demo",
        "Demo",
        "Drop 20 % of the packets of a real scene, conceal the losses, measure the quality, and write a report.",
    ),
    "train": Verb(
        "train",
        "Train",
        "Train a scene from a folder of posed photos (COLMAP, BungeeNeRF, Blender or nerfstudio layout).",
    ),
    "calibrate": Verb(
        "calibrate",
        "Calibrate",
        "Add a network, a sketch or a preview to the stream of a finished scene: calibrate gnn|sketch|preview.",
    ),
    "import": Verb(
        "import_model",
        "Import",
        "Import a model of other software: neural scenes as a scene file, explicit Gaussians as a standard PLY.",
    ),
    "export": Verb(
        "export",
        "Export",
        "Export a scene as explicit Gaussians, which common splat viewers open; the loss of quality is measured.",
    ),
    "encode": Verb("encode", "Encode", "Encode a scene into a stream of independently decodable packets."),
    "apply": Verb(
        "apply",
        "Apply",
        "Apply an update to a stream; the result is identical, byte by byte, to the new version of the stream.",
    ),
    "convert": Verb(
        "convert",
        "Convert",
        "Convert files of scenes and clips to another format, one or many: streams, explicit Gaussians, frames.",
    ),
    "inspect": Verb(
        "inspect",
        "Inspect",
        "Show the content of a stream, scene file or file of Gaussians: bytes by part, losses, bounds, problems.",
    ),
    "transmit": Verb(
        "transmit", "Transmit", "Simulate the transmission of a stream over a channel that loses packets."
    ),
    "plan": Verb(
        "plan",
        "PlanCommand",
        "Choose the protection of side information and importance tiers for a byte budget, for `serve --plan`.",
    ),
    "serve": Verb("serve", "Serve", "Serve streams over UDP or QUIC to many clients at once; stop with Ctrl-C."),
    "token": Verb(
        "token", "Token", "Print a signed token that opens private scenes of `serve --private` until it expires."
    ),
    "live": Verb(
        "live",
        "Live",
        "Encode frames as they appear, and serve them at once; stops at Ctrl-C or, with -, when standard input ends.",
    ),
    "receive": Verb(
        "receive",
        "Receive",
        "Receive a stream over UDP or QUIC; the packets received before a deadline form a scene or its preview.",
    ),
    "pack": Verb(
        "pack",
        "Pack",
        "Write one HTML file that shows streams in a browser; it needs nothing else, not even a network.",
    ),
    "publish": Verb(
        "publish",
        "Publish",
        "Write the folder of a static web site that shows scenes: pages, player, streams, thumbnails, and headers.",
    ),
    "view": Verb(
        "view", "View", "Show a stream in a browser, with losses, concealers, and the progress of the transfer."
    ),
    "verify": Verb(
        "verify",
        "Verify",
        "Check streams: container, manifest, side information, checksum of each packet, and that no packet is missing.",
    ),
    "decode": Verb("decode", "Decode", "Decode the received packets of a stream; no other file is needed."),
    "render": Verb(
        "render",
        "Render",
        "Render a scene from every camera to PNG files; a clip is rendered to one animated picture.",
    ),
    "thumb": Verb(
        "thumb",
        "Thumb",
        "Draw one picture that shows a scene: its initial view, or all of it from the side with the most detail.",
    ),
    "evaluate": Verb(
        "evaluate",
        "Evaluate",
        "Measure the quality of a stream or scene: drop packets, conceal, render the test views, and compare.",
    ),
    "compare": Verb(
        "compare",
        "Compare",
        "Compare files of one scene: bytes, quality against a reference in held-out views, decoding time.",
    ),
    "study": Verb(
        "study",
        "StudyCommand",
        "Run a protocol file: scenes, rows, losses and seeds. Finished units of work are not computed again.",
    ),
}
"""Verbs in the order of `splatwire --help`."""


def overview() -> str:
    """Returns the text of `splatwire --help`, wrapped to the width of the terminal."""
    width = max(shutil.get_terminal_size().columns, 40)
    column = max(map(len, VERBS)) + 4
    lines = ["usage: splatwire [-h] VERB ...", "", DESCRIPTION, "", "verbs:"]
    for name, verb in VERBS.items():
        first = f"  {name}".ljust(column)
        lines += textwrap.wrap(verb.help, width, initial_indent=first, subsequent_indent=" " * column)
    return "\n".join([*lines, "", "options:", "  -h, --help".ljust(column + 2) + "show this text and exit"])


def unknown_verb(name: str) -> str:
    """Returns the error message for an unknown subcommand or option, with the names of similar subcommands."""
    if name.startswith("-"):
        return f"unknown option {name}: the verb comes first, as in `splatwire encode --help`"
    similar = difflib.get_close_matches(name, VERBS, n=3)
    hint = f"did you mean {' or '.join(similar)}?" if similar else f"the verbs are {', '.join(VERBS)}"
    return f"'{name}' is no verb: {hint} (`splatwire --help` describes them)"
