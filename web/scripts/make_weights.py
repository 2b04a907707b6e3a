"""Writes the networks of the concealer `scene_free` for the concealers in TypeScript.

python web/scripts/make_weights.py

The weights are those of the package (`splatwire/assets`); a test compares the module.
"""

import base64
from pathlib import Path

import numpy as np

from splatwire.concealment.scene_free.network import Perceptron
from splatwire.concealment.scene_free.weights import default_anchor_weights, default_gaussian_weights

TARGET = Path(__file__).parents[1] / "src" / "conceal" / "scene_free_weights.ts"
HEAD = """\
// Made by web/scripts/make_weights.py; do not edit.

/** Little-endian 32-bit floats: mean, spread, weights (row by row) and biases of the first, then of the last layer. */
"""


def text_of(name: str, network: Perceptron) -> str:
    """Returns a network as a TypeScript constant."""
    hidden, output = network.hidden, network.output
    arrays = (network.mean, network.spread, hidden.weight, hidden.bias, output.weight, output.bias)
    values = np.concatenate([array.ravel() for array in arrays]).astype("<f4")
    text = base64.b64encode(values.tobytes()).decode()
    lines = " +\n".join(f'  "{text[i : i + 100]}"' for i in range(0, len(text), 100))
    num_hidden, num_inputs = hidden.weight.shape
    return f"export const {name} = {{ inputs: {num_inputs}, hidden: {num_hidden}, bytes:\n{lines},\n}};\n"


def module() -> str:
    """Returns the TypeScript module with both networks."""
    return HEAD + text_of("GAUSSIANS", default_gaussian_weights()) + "\n" + text_of("ANCHORS", default_anchor_weights())


def main() -> None:
    """Writes `src/conceal/scene_free_weights.ts`."""
    TARGET.write_text(module())


if __name__ == "__main__":
    main()
