"""Writes the networks of the concealer `scene_free` as the page's concealers read them.

python web/scripts/make_weights.py

The weights are those of the package (`splatwire/assets`); a test compares gains.
"""

import base64
from pathlib import Path

import numpy as np

from splatwire.conceal.scene_free.network import Perceptron
from splatwire.conceal.scene_free.weights import default_element_weights, default_weights

HEAD = """\
// Made by web/scripts/make_weights.py; do not edit.

/** Floats of 32 bits, little-endian: mean, spread, first layer (row by row) and its bias, last layer and its bias. */
"""


def text_of(name: str, network: Perceptron) -> str:
    """A network as a constant."""
    state = network.state_dict()
    names = ("mean", "spread", "layers.0.weight", "layers.0.bias", "layers.2.weight", "layers.2.bias")
    values = np.concatenate([state[name].numpy().ravel() for name in names]).astype("<f4")
    text = base64.b64encode(values.tobytes()).decode()
    lines = " +\n".join(f'  "{text[i : i + 100]}"' for i in range(0, len(text), 100))
    hidden, inputs = state["layers.0.weight"].shape
    return f"export const {name} = {{ inputs: {inputs}, hidden: {hidden}, bytes:\n{lines},\n}};\n"


def main() -> None:
    """Writes `src/conceal/scene_free_weights.ts`."""
    target = Path(__file__).parents[1] / "src" / "conceal" / "scene_free_weights.ts"
    target.write_text(
        HEAD + text_of("GAUSSIANS", default_element_weights()) + "\n" + text_of("ANCHORS", default_weights())
    )


if __name__ == "__main__":
    main()
