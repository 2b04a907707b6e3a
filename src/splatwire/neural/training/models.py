"""Interface of the context models in training."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.neural.training.causal import TrainableCausal
from splatwire.neural.training.causal_device import DeviceCausal
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache, MaskedAttributes, SampleBits
from splatwire.neural.training.hacpp import TrainableHacpp
from splatwire.neural.training.kernels import Kernels
from splatwire.neural.training.state import TrainState
from splatwire.types.causal_coding import CausalConfig


@runtime_checkable
class TrainableContextModel(Protocol):
    """Typing protocol (structural type) for a context model in training.

    The model adds noise in place of quantisation and estimates the rate.
    """

    def before_iteration(self, state: TrainState) -> None:
        """Prepares the model for an iteration. The training calls the method before each iteration."""
        # Before the first iteration whose loss includes the bit rate, an implementation sets `bounds_min` and
        # `bounds_max` of the state again and initialises its networks.

    def simulate_quantisation(
        self, state: TrainState, visible: Int64[Tensor, "M"]
    ) -> tuple[MaskedAttributes, SampleBits | None]:
        """Prepares the visible anchors for rendering, and estimates the bits of a random sample of all anchors.

        Args:
            state: State of the training.
            visible: Indices of the visible anchors.

        Returns:
            Attributes of the visible anchors with noise in place of rounding; their offset masks; and the estimated
            bits of the sample, or None while the loss excludes the bit rate.
        """

    def expected_scalings(self, state: TrainState, index: Int64[Tensor, "M"]) -> Float[Tensor, "M 6"]:
        """Predicts the scalings of anchors from their positions alone, world units.

        Args:
            state: State of the training.
            index: Indices of the M anchors in the training state.
        """

    def rate_loss(self, state: TrainState, estimated_bits: SampleBits) -> Float[Tensor, ""]:
        """Returns the rate term of the loss, given the estimated bits of a sample of anchors."""


def new_context_model(config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> TrainableContextModel:
    """Creates the trainer of the context model. The weights are in the state of the training.

    Args:
        config: Configuration of the training, which selects the kind of context model.
        kernels: Implementation of the operations, for the processor or for a GPU.
        cache: Cache of data that depend only on the positions of the anchors.
    """
    if not isinstance(config.model, CausalConfig):
        return TrainableHacpp(config, kernels, cache)
    return (DeviceCausal if kernels.asynchronous else TrainableCausal)(config, kernels, cache)
