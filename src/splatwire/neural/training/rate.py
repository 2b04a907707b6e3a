"""Estimates of code lengths under predicted distributions, differentiable, for the rate term of the loss."""

import torch
from jaxtyping import Float
from torch import Tensor

MIN_LIKELIHOOD = 1e-6
"""Lower clamp of likelihoods, with zero gradient below it (HAC++, rate)."""


def gaussian_likelihood(
    values: Float[Tensor, "N D"], mean: Float[Tensor, "N D"], scale: Float[Tensor, "N D"], step: Float[Tensor, "N 1"]
) -> Float[Tensor, "N D"]:
    """Returns the probability of each quantised value under its normal distribution.

    Args:
        values: Rounded values, or values with noise in place of rounding.
        mean: Mean of each value.
        scale: Standard deviation of each value, positive.
        step: Quantisation step.
    """
    # It is the probability of an interval of width `step`, centred on the value.
    # mirror both bounds to below the mean, where differences of tiny probabilities are precise
    distance = (values - mean).abs()
    return torch.special.ndtr((0.5 * step - distance) / scale) - torch.special.ndtr((-0.5 * step - distance) / scale)


def mixture_likelihood(
    first: Float[Tensor, "N D"], second: Float[Tensor, "N D"], logit_difference: Float[Tensor, "N D"]
) -> Float[Tensor, "N D"]:
    """Returns the mixture of two likelihoods; the first has the weight `sigmoid(logit_difference)`."""
    weight = torch.sigmoid(logit_difference)
    return weight * first + (1 - weight) * second


def bits(likelihood: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Returns the code length in bits, `-log2`, of likelihoods."""
    return -torch.log2(likelihood.clamp(min=MIN_LIKELIHOOD))


def binary_entropy_bits(ones: float, count: int) -> float:
    """Returns the ideal code length of `count` binary values in bits, if 1 has the probability `ones / count`."""
    share = min(max(ones / max(count, 1), 1e-9), 1 - 1e-9)
    entropy = torch.special.entr(torch.tensor([share, 1 - share], dtype=torch.float64)).sum()
    return count * float(entropy) / float(torch.log(torch.tensor(2.0, dtype=torch.float64)))
