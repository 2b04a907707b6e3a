"""The channel: maps a stream to a stream with fewer packets. numpy and the standard library only."""

from splatwire.channel.loss_models import UNITS, Bernoulli, GilbertElliott, LossModel, Nothing
from splatwire.channel.loss_text import LOSS_PRESETS, parse_loss
from splatwire.channel.trace import Trace
from splatwire.channel.transmit import LossMask, TransmitRecord, draw_mask, transmit

__all__ = [
    "LOSS_PRESETS",
    "UNITS",
    "Bernoulli",
    "GilbertElliott",
    "LossMask",
    "LossModel",
    "Nothing",
    "Trace",
    "TransmitRecord",
    "draw_mask",
    "parse_loss",
    "transmit",
]
