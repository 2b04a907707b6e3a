"""What an iteration asks of the model that a scene is to be coded with."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.model.causal import CausalConfig
from splatwire.train.causal import TrainedCausal
from splatwire.train.causal_device import DeviceCausal
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache, SampleRate, Seen, TrainedContext
from splatwire.train.kernels import Kernels
from splatwire.train.state import TrainState


@runtime_checkable
class TrainedModel(Protocol):
    """The model in training."""

    def begin(self, state: TrainState) -> None:
        """Gets ready before an iteration."""

    def observe(self, state: TrainState, visible: Int64[Tensor, "M"]) -> tuple[Seen, SampleRate | None]:
        """Returns what is drawn of the visible anchors, and the rate of a sample of all as far as the phase has one."""

    def expected_scalings(self, state: TrainState, index: Int64[Tensor, "M"]) -> Float[Tensor, "M 6"]:
        """The scalings that are expected of anchors of which nothing is known but their places."""

    def rate_loss(self, state: TrainState, rate: SampleRate) -> Float[Tensor, ""]:
        """What a rate adds to the loss."""


def trained_model(config: TrainConfig, kernels: Kernels, cache: AnchorCache) -> TrainedModel:
    """The model of a recipe."""
    if not isinstance(config.model, CausalConfig):
        return TrainedContext(config, kernels, cache)
    return (DeviceCausal if kernels.asynchronous else TrainedCausal)(config, kernels, cache)
