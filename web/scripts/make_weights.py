"""Writes the networks of the concealer `scene_free` for the concealers in TypeScript.

python web/scripts/make_weights.py

The weights are those of the package (`splatwire/assets`); a test compares gains.
"""

import base64
from pathlib import Path

import numpy as np

from splatwire.concealment.scene_free.network import Perceptron
from splatwire.concealment.scene_free.weights import default_anchor_weights, default_gaussian_weights

HEAD = """\
// Made by web/scripts/make_weights.py; do not edit.

/** Little-endian 32-bit floats: mean, spread, weights (row by row) and biases of the first, then of the last layer. */
"""


def text_of(name: str, network: Perceptron) -> str:
    """Returns a network as a TypeScript constant."""
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
        HEAD + text_of("GAUSSIANS", default_gaussian_weights()) + "\n" + text_of("ANCHORS", default_anchor_weights())
    )


if __name__ == "__main__":
    main()
