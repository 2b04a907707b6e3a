"""The neural network of the concealer `scene_free`: predicts factors on size and opacity of received anchors."""

from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
from jaxtyping import Float, Int64

from splatwire.concealment.grow import Grow
from splatwire.concealment.scene_free.signature import SIGNATURE, near_losses, signatures
from splatwire.concealment.scene_free.surroundings import Surroundings
from splatwire.types import ReceivedScene
from splatwire.types.networks import Linear

HIDDEN = 24
"""Number of units of the hidden layer of the network."""
Own = TypeVar("Own", bound="Perceptron")
MAX_STANDARDISED = 3.0
"""Clamping limit of standardised inputs, in standard deviations; prevents extrapolation on unusual scenes."""
MAX_CHANGE = 0.3
"""Maximum change of the logarithm of a gain by the network."""


@dataclass(frozen=True, eq=False)
class AnchorInputs:
    """Inputs of the neural network that predicts the enlargement of received anchors next to lost ones.

    Attributes:
        rows: Indices of the received anchors, int64 (M).
        signature: Input features of these anchors (`signatures`).
        grown: Factors by which the concealer `grow` enlarges the anchors; the network corrects them.
    """

    rows: Int64[np.ndarray, "M"]
    signature: Float[np.ndarray, "M D"]
    grown: Float[np.ndarray, "M"]


def anchor_inputs(received: ReceivedScene, surroundings: Surroundings) -> AnchorInputs:
    """Computes the inputs of the network that predicts the enlargement of received anchors.

    Args:
        received: The received scene.
        surroundings: Neighbours and expected sizes of the received anchors.
    """
    grown = Grow().gain(1 - near_losses(received, surroundings), received.fully_received, received.tier_sizes)
    return AnchorInputs(surroundings.rows, signatures(received, surroundings), grown)


@dataclass(frozen=True, eq=False)
class Perceptron:
    """A neural network with standardised inputs, one hidden layer (SiLU) and two outputs.

    Attributes:
        mean: Mean of each input over the training data.
        spread: Standard deviation of each input, above 0.
        hidden: The hidden layer.
        output: The output layer.
    """

    INPUTS: ClassVar[int]
    """Number of inputs of the network, D."""
    mean: Float[Any, "D"]
    spread: Float[Any, "D"]
    hidden: Linear
    output: Linear

    @classmethod
    def untrained(cls: type[Own], hidden: int = HIDDEN, *, seed: int = 0) -> Own:
        """Returns an untrained network, whose two outputs are 0 for any input.

        The weights of the hidden layer are random, those of the output layer are 0.

        Args:
            hidden: Number of hidden units.
            seed: Random seed.
        """
        rng, bound = np.random.default_rng(seed), cls.INPUTS**-0.5
        first = Linear(
            rng.uniform(-bound, bound, (hidden, cls.INPUTS)).astype(np.float32),
            rng.uniform(-bound, bound, hidden).astype(np.float32),
        )
        last = Linear(np.zeros((2, hidden), np.float32), np.zeros(2, np.float32))
        return cls(np.zeros(cls.INPUTS, np.float32), np.ones(cls.INPUTS, np.float32), first, last)

    def evaluate(self, signature: Float[np.ndarray, "M D"]) -> Float[np.ndarray, "M 2"]:
        """Computes the network for several received elements at once.

        Args:
            signature: The D inputs of each of M elements.

        Returns:
            The two outputs for each element, without activation.
        """
        x = np.clip((signature - self.mean) / self.spread, -MAX_STANDARDISED, MAX_STANDARDISED)
        h = x @ self.hidden.weight.T + self.hidden.bias
        h = h / (1 + np.exp(-h))
        return h @ self.output.weight.T + self.output.bias


class AnchorNetwork(Perceptron):
    """A small neural network that corrects the enlargement of received anchors by the concealer `grow`.

    The network has two outputs, both logarithms of factors. The first factor corrects the enlargement; the second
    changes the opacity.
    """

    INPUTS = SIGNATURE

    def __call__(
        self, inputs: AnchorInputs, trust: float | int = 1.0
    ) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]:
        """Computes factors (gains) on the size and on the opacity of each received anchor, positive, float (M) each.

        Args:
            inputs: Inputs of the network for M received anchors.
            trust: Factor on the network's correction, 0 for none.
        """
        change = trust * np.clip(self.evaluate(inputs.signature), -MAX_CHANGE, MAX_CHANGE)
        return inputs.grown * np.exp(change[:, 0]), np.exp(change[:, 1])
