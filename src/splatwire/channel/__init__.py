"""Channel simulation: removes lost packets from a stream."""

from splatwire.channel.loss_models import UNITS, Bernoulli, GilbertElliott, LossModel, NoLoss
from splatwire.channel.loss_text import LOSS_PRESETS, parse_loss
from splatwire.channel.registry import register_loss_model
from splatwire.channel.trace import Trace
from splatwire.channel.transmit import PacketLossMask, TransmitRecord, draw_mask, transmit

__all__ = [
    "LOSS_PRESETS",
    "UNITS",
    "Bernoulli",
    "GilbertElliott",
    "LossModel",
    "NoLoss",
    "PacketLossMask",
    "Trace",
    "TransmitRecord",
    "draw_mask",
    "parse_loss",
    "register_loss_model",
    "transmit",
]
