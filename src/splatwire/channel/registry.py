"""Registry of loss models, which other packages can extend (`docs/your-own-concealer.md`)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from splatwire.arguments import checked
from splatwire.channel.loss_models import LossModel, draw_checked
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.plugins import Registry, source_of

GROUP = "splatwire.loss_models"
"""Entry point group in which installed packages declare loss models."""
Make = TypeVar("Make", bound=Callable[..., LossModel])


@dataclass(frozen=True)
class LossText:
    """Registry entry that creates one kind of loss model from parameters given as text.

    Attributes:
        make: Function or class that creates the loss model. It is called with the text of the parameters, such as
            `0.2`, and with the keyword argument `unit`.
        form: Syntax of the model's text, such as `bernoulli:RATE`, for error messages.
    """

    make: Callable[..., LossModel]
    form: str


LOSS_MODELS: Registry[LossText] = Registry("loss model", GROUP)


@checked
def register_loss_model(name: str, *, form: str | None = None) -> Callable[[Make], Make]:
    """Returns a decorator that registers a function or class as a loss model.

    The function or class is called with the parameters of the model as text and with the keyword `unit`, one of
    `splatwire.channel.UNITS`, and returns the loss model.

    Args:
        name: Name of the model: the text before the colon of `NAME:PARAMETERS`.
        form: Syntax of the model's text, such as `bernoulli:RATE`, for error messages; None for `NAME:...`.

    Raises:
        InvalidValueError: If another loss model has that name, or the decorated object is not callable.
    """

    def register(make: Make) -> Make:
        if not callable(make):
            raise InvalidValueError(f"loss model '{name}' is a {type(make).__name__}, not a class or function")
        LOSS_MODELS.register(name, LossText(make, form or f"{name}:..."), source_of(make))
        return make

    return register


def make_loss(name: str, text: str, unit: str) -> LossModel:
    """Creates a registered loss model with given parameters.

    Args:
        name: Name under which the model is registered, such as `bernoulli`.
        text: Parameters of the model: the text after the colon, such as `0.2`.
        unit: Unit of loss: `pak` (whole packets of the stream) or `datagram`.

    Raises:
        UnknownNameError: If the model is unknown.
        InvalidValueError: If the parameters are invalid, or the model does not implement `LossModel`.
    """
    loss_model = LOSS_MODELS[name]
    try:
        made = loss_model.make(text, unit=unit)
    except SplatwireError:
        raise
    except (TypeError, ValueError) as error:
        raise InvalidValueError(f"'{name}:{text}' should look like {loss_model.form}: {error}") from error
    if not isinstance(made, LossModel):
        absent = ", ".join(member for member in ("name", "received", "unit") if not hasattr(made, member))
        raise InvalidValueError(
            f"loss model '{name}'{LOSS_MODELS.provider_suffix(name)} is no loss model: it has no {absent}"
        )
    return made if type(made).__module__.startswith("splatwire.") else CheckedLoss(made, unit)


@dataclass(frozen=True)
class CheckedLoss:
    """Loss model registered by an installed package, wrapped to check each mask that the model returns.

    Attributes:
        model: Loss model of the other package.
        unit: Unit of loss: `pak` (whole packets of the stream) or `datagram`.
    """

    model: LossModel
    unit: str

    @property
    def name(self) -> str:
        """Name of the loss model with its parameters, such as `bernoulli:0.2`."""
        return self.model.name

    def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draws which of n packets or datagrams are received.

        Args:
            n: Number of packets or datagrams sent.
            rng: Random generator.

        Returns:
            True for each received packet or datagram, in sending order, bool, shape (n,).

        Raises:
            InvalidValueError: If the wrapped model does not return n booleans.
        """
        return draw_checked(self.model, n, rng)
