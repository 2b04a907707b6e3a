"""Concealment: makes a received scene with lost elements renderable; received values never change."""

from splatwire.concealment.base import Concealed, Concealer
from splatwire.concealment.coarse import Coarse
from splatwire.concealment.conceal import conceal, conceal_if_received
from splatwire.concealment.drop import Drop
from splatwire.concealment.grow import Grow
from splatwire.concealment.registry import concealer_names, create_concealer, register_concealer
from splatwire.concealment.scene_free import SceneFree
from splatwire.concealment.sketch import Sketch

__all__ = [
    "Coarse",
    "Concealed",
    "Concealer",
    "Drop",
    "Grow",
    "SceneFree",
    "Sketch",
    "conceal",
    "conceal_if_received",
    "concealer_names",
    "create_concealer",
    "register_concealer",
]
