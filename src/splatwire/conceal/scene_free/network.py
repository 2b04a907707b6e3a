"""The network of the scene-free concealer: from signatures to gains."""

from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
from jaxtyping import Float, Int64

from splatwire.conceal.grow import Grow
from splatwire.conceal.scene_free.signature import SIGNATURE, near_losses, signatures
from splatwire.conceal.scene_free.surroundings import Surroundings
from splatwire.model import Partial
from splatwire.model.networks import Linear

HIDDEN = 24
"""Width of the hidden layer."""
Own = TypeVar("Own", bound="Perceptron")
MOST_UNUSUAL = 3.0
"""Limit of standardised inputs, in standard deviations: no scene makes the network extrapolate."""
MOST_CHANGE = 0.3
"""Largest change of the logarithm of a gain."""


@dataclass(frozen=True, eq=False)
class GainInputs:
    """Inputs of the network for one loss of one scene; computing them takes the time, the network hardly any.

    Attributes:
        rows: The received anchors.
        signature: Their `signatures`.
        grown: Their size gain by the rule of `grow`, from which the network starts.
    """

    rows: Int64[np.ndarray, "M"]
    signature: Float[np.ndarray, "M D"]
    grown: Float[np.ndarray, "M"]


def gain_inputs(partial: Partial, around: Surroundings) -> GainInputs:
    """Computes the inputs.

    Args:
        partial: The received scene.
        around: Surroundings of the received anchors.
    """
    grown = Grow().gain(1 - near_losses(partial, around), partial.known, partial.tier_sizes)
    return GainInputs(around.rows, signatures(partial, around), grown)


@dataclass(frozen=True, eq=False)
class Perceptron:
    """One hidden layer (SiLU) between standardised inputs and two numbers.

    Attributes:
        mean: Mean of each input over the training data.
        spread: Standard deviation of each input, above 0.
        hidden: The hidden layer.
        output: The output layer.
    """

    INPUTS: ClassVar[int]
    """Number of inputs, D."""
    mean: Float[Any, "D"]
    spread: Float[Any, "D"]
    hidden: Linear
    output: Linear

    @classmethod
    def untrained(cls: type[Own], hidden: int = HIDDEN, *, seed: int = 0) -> Own:
        """Returns a network whose outputs are 0: random weights in the hidden layer, zeros in the output layer."""
        rng, bound = np.random.default_rng(seed), cls.INPUTS**-0.5
        first = Linear(
            rng.uniform(-bound, bound, (hidden, cls.INPUTS)).astype(np.float32),
            rng.uniform(-bound, bound, hidden).astype(np.float32),
        )
        last = Linear(np.zeros((2, hidden), np.float32), np.zeros(2, np.float32))
        return cls(np.zeros(cls.INPUTS, np.float32), np.ones(cls.INPUTS, np.float32), first, last)

    def evaluate(self, signature: Float[np.ndarray, "M D"]) -> Float[np.ndarray, "M 2"]:
        """Evaluates the network; inputs beyond `MOST_UNUSUAL` are clamped."""
        x = np.clip((signature - self.mean) / self.spread, -MOST_UNUSUAL, MOST_UNUSUAL)
        h = x @ self.hidden.weight.T + self.hidden.bias
        h = h / (1 + np.exp(-h))
        return h @ self.output.weight.T + self.output.bias


class GainNetwork(Perceptron):
    """A small perceptron that corrects the gains of `grow`. Untrained it corrects nothing."""

    INPUTS = SIGNATURE

    def __call__(
        self, inputs: GainInputs, trust: float | int = 1.0
    ) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]:
        """Computes the gains of size and opacity, positive.

        Args:
            inputs: The network's inputs.
            trust: Factor on the network's correction, 0 for none.
        """
        change = trust * np.clip(self.evaluate(inputs.signature), -MOST_CHANGE, MOST_CHANGE)
        return inputs.grown * np.exp(change[:, 0]), np.exp(change[:, 1])
