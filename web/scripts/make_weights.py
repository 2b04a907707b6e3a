"""Writes the network of the concealer `scene_free` for explicit Gaussians as the page's concealer reads it.

python web/scripts/make_weights.py

The weights are those of the package (`splatwire/assets`); a test compares gains.
"""

import base64
from pathlib import Path

import numpy as np

from splatwire.conceal.scene_free import elements, weights

HEAD = """\
// Made by web/scripts/make_weights.py; do not edit.

export const INPUTS = {inputs}, HIDDEN = {hidden};

/** Floats of 32 bits, little-endian: mean, spread, first layer (row by row) and its bias, last layer and its bias. */
export const BYTES =
"""


def main() -> None:
    """Writes `src/conceal/scene_free_weights.ts`."""
    state = weights.default_element_weights().state_dict()
    names = ("mean", "spread", "layers.0.weight", "layers.0.bias", "layers.2.weight", "layers.2.bias")
    values = np.concatenate([state[name].numpy().ravel() for name in names]).astype("<f4")
    text = base64.b64encode(values.tobytes()).decode()
    lines = [f'  "{text[i : i + 100]}"' for i in range(0, len(text), 100)]
    head = HEAD.format(inputs=elements.ELEMENT_SIGNATURE, hidden=len(state["layers.0.bias"]))
    target = Path(__file__).parents[1] / "src" / "conceal" / "scene_free_weights.ts"
    target.write_text(head + " +\n".join(lines) + ";\n")


if __name__ == "__main__":
    main()
