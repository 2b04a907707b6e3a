"""Writes the constants that the page shares with Python: limits, section names, layouts and wire messages.

python web/scripts/make_tables.py

A test compares the committed files with this output.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from splatwire.bitstream import limits, tile_index
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec import (
    antialiasing,
    initial_view,
    metadata,
    preview,
    tier_sizes,
    tiers,
    weight_bytes,
    weights,
)
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.gaussians import blocks
from splatwire.codec.gaussians import layout as gaussians
from splatwire.codec.sequence import layout as motion
from splatwire.codec.sequence import lifetimes
from splatwire.concealment.sketch import section as sketch
from splatwire.entropy import integers
from splatwire.sequence.encoding import FIRST_FRAME
from splatwire.transport.protocol import gap_tracker, messages, nack, receiver, wire
from splatwire.transport.protocol.collect import ReceiverLimits

SOURCES = Path(__file__).parents[1] / "src"
MADE = "// Made by web/scripts/make_tables.py; do not edit.\n\n"
LIMITS = "// Limits of the stream format. Counterpart of `splatwire.bitstream.limits`.\n\n"
NETWORKS = "// Size limits of quantised networks. Counterpart of `splatwire.codec.weight_bytes`.\n\n"
GAUSSIANS = (
    "// Constants of the Gaussian codec. Counterpart of `splatwire.codec.gaussians.layout`, which describes them.\n\n"
)
MOTION = "// Constants of the motion codec. Counterpart of `splatwire.codec.sequence.layout`, which describes them.\n\n"
SECTIONS = "// Names of sections of the side information.\n\n"
WIRE = "// Constants of the wire protocol. Counterpart of `splatwire.transport.protocol`, which describes them.\n\n"
LINE = 120
SECTION_NAMES = {
    "ANTIALIASED": antialiasing.SECTION, "BACKGROUND": BACKGROUND_SECTION.name, "EXTENT": initial_view.EXTENT_SECTION,
    "FIRST_FRAME": FIRST_FRAME, "LIFETIMES": lifetimes.SECTION, "METADATA": metadata.SECTION,
    "ORIGIN": ORIGIN_SECTION.name, "PREVIEW": preview.SECTION, "SKETCH": sketch.SECTION, "TIERS": tiers.SECTION,
    "TIER_SIZES": tier_sizes.SECTION, "TILES": tile_index.SECTION, "UP": initial_view.UP_SECTION,
    "VIEWPOINT": initial_view.SECTION,
}  # fmt: skip
WIRE_NAMES = {
    wire: (
        "VERSION", "REQUEST", "WELCOME", "INIT_SYMBOL", "DATA", "PARITY", "FEEDBACK", "BYE", "REFUSE", "END", "HAVE",
        "VIEW_UPDATE", "LIVE", "VIEW_DEPENDENT", "MAX_DATAGRAM",
    ),
    messages: (
        "REFUSALS", "NOT_YET", "OTHER_VERSION", "MAX_NAME", "MAX_NACKS", "MAX_PARITY_RANGES", "MAX_DECLARED",
        "MAX_PREVIEW", "MAX_HELD_BYTES",
    ),
    nack: ("MAX_NACK_ATTEMPTS",),
    gap_tracker: ("MAX_GAPS",),
    receiver: ("REORDER_THRESHOLD", "MAX_SEQUENCE_JUMP", "MAX_FRUITLESS_ENDS"),
}  # fmt: skip
NETWORK_LIMITS = {
    weight_bytes: ("MAX_WIDTH", "MAX_WEIGHTS"), weights: ("MAX_SHIFT", "MAX_STEP"), integers: ("MAX_SYMBOL",),
}  # fmt: skip


def limits_module() -> str:
    """Returns a TypeScript module with every constant of `splatwire.bitstream.limits`, and its schemas."""
    found = {name: value for name, value in vars(limits).items() if name.isupper() and type(value) in (int, str, tuple)}
    codecs = ("HACPP_ANCHORS", "CAUSAL", "GAUSSIANS", "TRACKS", "LEVELS", "UPDATE", "FORMAT_1_SECTIONS")
    lines = [_laid_out(f"export const {name} = ", value, ";") for name, value in found.items() if name not in codecs]
    schemas = [
        f"  {schema.name}: {{\n    formatVersion: {schema.format_version},\n"
        f"    elements: {json.dumps(schema.elements)},\n"
        f"{_laid_out('    sections: ', schema.sections, ',')}\n    elementsPerByte: {schema.elements_per_byte},\n"
        f"    maxTiers: {schema.max_tiers},\n    timed: {json.dumps(schema.timed)},\n  }},"
        for schema in limits.SCHEMAS.registered().values()
    ]
    return MADE + LIMITS + "\n".join([*lines, "export const SCHEMAS = {", *schemas, "};"]) + "\n"


def _laid_out(before: str, value: object, after: str) -> str:
    """Formats a value as biome does: on one line if it fits."""
    line = before + json.dumps(value) + after
    if len(line) <= LINE or not isinstance(value, tuple):
        return line
    return "\n".join([before + "[", *(f"  {json.dumps(entry)}," for entry in value), "]" + after])


def network_module() -> str:
    """Returns a TypeScript module with the limits of quantised networks."""
    lines = [f"export const {name} = {getattr(of, name)};" for of, names in NETWORK_LIMITS.items() for name in names]
    return MADE + NETWORKS + "\n".join(lines) + "\n"


def gaussians_module() -> str:
    """Returns a TypeScript module with the constants of `splatwire.codec.gaussians.layout`; names are counted."""
    values = {
        name: len(value) if isinstance(value, tuple) else np.asarray(value).tolist()
        for name, value in vars(gaussians).items()
        if name.isupper()
    }
    values["COEFFICIENTS"] = tuple(values["COEFFICIENTS"])
    return MADE + GAUSSIANS + _exported({**values, "ONE": 1 << gaussians.DIRECTION_BITS, "BOX_BITS": blocks.BOX_BITS})


def motion_module() -> str:
    """Returns a TypeScript module with the integers of `splatwire.codec.sequence.layout`."""
    found = {name: value for name, value in vars(motion).items() if name.isupper() and not isinstance(value, tuple)}
    values = {name: np.asarray(value).tolist() for name, value in found.items()}
    return MADE + MOTION + _exported({**values, "WEIGHT": 1 << motion.WEIGHT_BITS})


def section_names_module() -> str:
    """Returns a TypeScript module with the names of sections of the side information."""
    return MADE + SECTIONS + _exported(SECTION_NAMES)


def wire_module() -> str:
    """Returns a TypeScript module with kinds and limits of wire messages, as far as browsers need them."""
    values = {name: getattr(module, name) for module, names in WIRE_NAMES.items() for name in names}
    limits_of_receivers = {
        "MAX_INIT_SEGMENT_BYTES": ReceiverLimits.init_segment_bytes,
        "MAX_PACKETS": ReceiverLimits.packets,
    }
    intervals = {"NACK_INTERVAL_MS": nack.NACK_INTERVAL_S, "FEEDBACK_MS": receiver.FEEDBACK_INTERVAL_S}
    milliseconds = {name: round(1000 * seconds) for name, seconds in intervals.items()}
    return MADE + WIRE + _exported({**values, **limits_of_receivers, **milliseconds})


def _exported(values: Mapping[str, object]) -> str:
    return "".join(_laid_out(f"export const {name} = ", value, ";") + "\n" for name, value in values.items())


FILES = {
    "codec/gaussians/layout.ts": gaussians_module,
    "codec/tracks/layout.ts": motion_module,
    "packets/section_names.ts": section_names_module,
    "transport/wire.ts": wire_module,
    "packets/limits.ts": limits_module,
    "codec/network_limits.ts": network_module,
}
"""Generator of each file, by its path below `src`."""


def main() -> None:
    """Writes all files."""
    for name, module in FILES.items():
        (SOURCES / name).write_text(module())


if __name__ == "__main__":
    main()
