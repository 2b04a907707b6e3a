"""What the hash grid predicts about an anchor before any packet has arrived."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class AttributePrior:
    """Predicted Gaussian and quantisation step of one attribute of N anchors.

    Attributes:
        mean: Predicted value per channel.
        scale: Predicted standard deviation per channel, positive.
        step: Quantisation step, one per anchor.
    """

    mean: Float[Tensor, "N D"]
    scale: Float[Tensor, "N D"]
    step: Float[Tensor, "N 1"]


@dataclass(frozen=True, eq=False)
class Prior:
    """The hash-grid prior of N anchors (HACPP_SPEC 4.1, paper equation of `mu(x)`).

    Attributes:
        feature: Prior of the F feature channels.
        scaling: Prior of the 6 scalings.
        offset: Prior of the offsets, flattened offset-major to 3 K channels.
        context: Interpolated hash-grid feature.
    """

    feature: AttributePrior
    scaling: AttributePrior
    offset: AttributePrior
    context: Float[Tensor, "N H"]
