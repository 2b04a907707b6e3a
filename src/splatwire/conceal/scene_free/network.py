"""The network of the scene-free concealer: from signatures to gains."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from splatwire.conceal.grow import Grow
from splatwire.conceal.scene_free.signature import SIGNATURE, near_losses, signatures
from splatwire.conceal.scene_free.surroundings import Surroundings
from splatwire.model import Partial

HIDDEN = 24
_MOST_UNUSUAL = 3.0
"""Signatures are cut at this many standard deviations: no scene is so odd that the network runs away."""
_MOST_CHANGE = 0.3
"""Largest change of the logarithm of a gain."""


@dataclass(frozen=True, eq=False)
class GainInputs:
    """All that the network needs of one loss of one scene; costs the time, the network itself next to none.

    Attributes:
        rows: The received anchors.
        signature: Their `signatures`.
        grown: Their size gain by the rule of `grow`, from which the network starts.
    """

    rows: Int64[Tensor, "M"]
    signature: Float[Tensor, "M D"]
    grown: Float[Tensor, "M"]


def gain_inputs(partial: Partial, around: Surroundings) -> GainInputs:
    """Computes the inputs.

    Args:
        partial: What arrived, in main memory.
        around: Surroundings of the received anchors.
    """
    grown = Grow().gain(1 - near_losses(partial, around), partial.known, partial.tier_sizes)
    return GainInputs(around.rows, signatures(partial, around), grown)


class Perceptron(nn.Module):
    """One hidden layer between standardised inputs and two numbers, 0 at first."""

    mean: Tensor
    spread: Tensor

    def __init__(self, inputs: int, hidden: int, *, seed: int) -> None:
        super().__init__()
        first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, 2)
        rng = torch.Generator().manual_seed(seed)
        bound = 1 / math.sqrt(inputs)
        with torch.no_grad():
            for parameter in first.parameters():
                parameter.copy_((2 * torch.rand(parameter.shape, generator=rng) - 1) * bound)
            for parameter in last.parameters():
                parameter.zero_()
        self.layers = nn.Sequential(first, nn.SiLU(), last)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("spread", torch.ones(inputs))

    def opinion(self, signature: Float[Tensor, "M D"]) -> Float[Tensor, "M 2"]:
        """What it makes of inputs; unusual ones are cut off."""
        x = ((signature - self.mean) / self.spread).clamp(-_MOST_UNUSUAL, _MOST_UNUSUAL)
        opinion: Tensor = self.layers(x)
        return opinion


class GainNetwork(Perceptron):
    """A small perceptron that corrects the gains of `grow`. Untrained it corrects nothing."""

    def __init__(self, hidden: int = HIDDEN, *, seed: int = 0) -> None:
        super().__init__(SIGNATURE, hidden, seed=seed)

    def forward(self, inputs: GainInputs, trust: float | int = 1.0) -> tuple[Float[Tensor, "M"], Float[Tensor, "M"]]:
        """Computes the gains of size and opacity, positive.

        Args:
            inputs: What is known.
            trust: How much of the network's correction is taken, 0 for none.
        """
        change = trust * self.opinion(inputs.signature).clamp(-_MOST_CHANGE, _MOST_CHANGE)
        return inputs.grown * change[:, 0].exp(), change[:, 1].exp()
