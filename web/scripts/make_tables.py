"""Writes the limits that the browser's decoder shares with Python: what a stream and its networks may be.

python web/scripts/make_tables.py

A test compares what is there with what this writes.
"""

import json
from pathlib import Path

from splatwire.codec import weight_bytes, weights
from splatwire.entropy import integers
from splatwire.packets import limits

SOURCES = Path(__file__).parents[1] / "src"
MADE = "// Made by web/scripts/make_tables.py; do not edit.\n\n"
LIMITS = "// What a stream may be: the twin of `splatwire.packets.limits`.\n\n"
NETWORKS = "// How large quantised networks may be: the twin of `splatwire.codec.weight_bytes`.\n\n"
LINE = 120
NETWORK_LIMITS = {
    weight_bytes: ("MAX_WIDTH", "MAX_WEIGHTS"), weights: ("MAX_SHIFT", "MAX_STEP"), integers: ("MAX_SYMBOL",),
}  # fmt: skip


def limits_module() -> str:
    """Every constant of `splatwire.packets.limits`, and its schemas."""
    found = {name: value for name, value in vars(limits).items() if name.isupper() and type(value) in (int, str, tuple)}
    codecs = ("ANCHORS", "CAUSAL", "GAUSSIANS", "COLUMNS", "TRACKS", "LEVELS", "FORMAT_1_SECTIONS")
    lines = [_laid_out(f"export const {name} = ", value, ";") for name, value in found.items() if name not in codecs]
    schemas = [
        f"  {schema.name}: {{\n    formatVersion: {schema.format_version},\n"
        f"    elements: {json.dumps(schema.elements)},\n"
        f"{_laid_out('    sections: ', schema.sections, ',')}\n    elementsPerByte: {schema.elements_per_byte},\n"
        f"    maxTiers: {schema.max_tiers},\n    timed: {json.dumps(schema.timed)},\n  }},"
        for schema in limits.SCHEMAS.values()
    ]
    return MADE + LIMITS + "\n".join([*lines, "export const SCHEMAS = {", *schemas, "};"]) + "\n"


def _laid_out(before: str, value: object, after: str) -> str:
    """A value as the formatter lays it out: on one line where it fits."""
    line = before + json.dumps(value) + after
    if len(line) <= LINE or not isinstance(value, tuple):
        return line
    return "\n".join([before + "[", *(f"  {json.dumps(entry)}," for entry in value), "]" + after])


def network_module() -> str:
    """Limits of quantised networks."""
    lines = [f"export const {name} = {getattr(of, name)};" for of, names in NETWORK_LIMITS.items() for name in names]
    return MADE + NETWORKS + "\n".join(lines) + "\n"


FILES = {
    "packets/limits.ts": limits_module,
    "codec/network_limits.ts": network_module,
}
"""What writes each file, below `src`."""


def main() -> None:
    """Writes them all."""
    for name, module in FILES.items():
        (SOURCES / name).write_text(module())


if __name__ == "__main__":
    main()
