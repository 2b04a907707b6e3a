"""The channel: maps a stream to a stream with fewer packets. numpy and the standard library only."""

from splatwire.channel.loss_models import Bernoulli, GilbertElliott, LossModel, Nothing
from splatwire.channel.loss_text import LOSS_PRESETS, parse_loss
from splatwire.channel.trace import Trace
from splatwire.channel.transmit import TransmitRecord, transmit

__all__ = [
    "LOSS_PRESETS",
    "Bernoulli",
    "GilbertElliott",
    "LossModel",
    "Nothing",
    "Trace",
    "TransmitRecord",
    "parse_loss",
    "transmit",
]
