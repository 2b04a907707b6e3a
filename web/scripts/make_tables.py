"""Writes the table of the normal distribution that the browser's decoder uses.

python web/scripts/make_tables.py

It is made with the decimal module (`splatwire.entropy.tables`), which JavaScript lacks; a test compares digests.
"""

import base64
from pathlib import Path

from splatwire.entropy.tables import TOTAL_BITS, normal_table

HEAD = """\
// Made by web/scripts/make_tables.py; do not edit.

/** Standard normal distribution function from 0 to 6 by 1/128, less 1/2, out of 2^24: three bytes each, low first. */
export const UPPER_NORMAL =
"""


def main() -> None:
    """Writes `src/entropy/normal_table.ts`."""
    values = normal_table()
    upper = [int(v) - (1 << (TOTAL_BITS - 1)) for v in values[len(values) // 2 :]]
    text = base64.b64encode(b"".join(v.to_bytes(3, "little") for v in upper)).decode()
    lines = [f'  "{text[i : i + 100]}"' for i in range(0, len(text), 100)]
    target = Path(__file__).parents[1] / "src" / "entropy" / "normal_table.ts"
    target.write_text(HEAD + " +\n".join(lines) + ";\n")


if __name__ == "__main__":
    main()
