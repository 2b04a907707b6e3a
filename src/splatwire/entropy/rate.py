"""What a value costs under its predicted distribution, in bits: the coder's distributions, differentiable."""

import torch
from jaxtyping import Float
from torch import Tensor

MIN_LIKELIHOOD = 1e-6
"""Likelihoods below this cost as much as this, and pull at nothing (HAC++, rate)."""


def gaussian_likelihood(
    values: Float[Tensor, "N D"], mean: Float[Tensor, "N D"], scale: Float[Tensor, "N D"], step: Float[Tensor, "N 1"]
) -> Float[Tensor, "N D"]:
    """Computes the probability of the interval of width `step` around each value.

    Args:
        values: Values, or values with noise in place of rounding.
        mean: Mean of each.
        scale: Standard deviation of each, positive.
        step: Quantisation step.
    """
    # Both bounds on the lower side of the mean: there differences of tiny probabilities keep their digits.
    distance = (values - mean).abs()
    return torch.special.ndtr((0.5 * step - distance) / scale) - torch.special.ndtr((-0.5 * step - distance) / scale)


def mixture_likelihood(
    first: Float[Tensor, "N D"], second: Float[Tensor, "N D"], logit_difference: Float[Tensor, "N D"]
) -> Float[Tensor, "N D"]:
    """Mixes two likelihoods; the first has the weight `sigmoid(logit_difference)`."""
    weight = torch.sigmoid(logit_difference)
    return weight * first + (1 - weight) * second


def bits(likelihood: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Returns `-log2` of likelihoods, each at least `MIN_LIKELIHOOD`."""
    return -torch.log2(likelihood.clamp(min=MIN_LIKELIHOOD))


def binary_entropy_bits(ones: float, count: int) -> float:
    """Returns the bits of `count` binary values of which `ones` are 1, under one model with their own frequency."""
    share = min(max(ones / max(count, 1), 1e-9), 1 - 1e-9)
    entropy = torch.special.entr(torch.tensor([share, 1 - share], dtype=torch.float64)).sum()
    return count * float(entropy) / float(torch.log(torch.tensor(2.0, dtype=torch.float64)))
