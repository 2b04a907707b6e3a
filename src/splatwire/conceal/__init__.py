"""Concealment: a scene with gaps becomes one that can be rendered; what was received never changes."""

from splatwire.conceal.base import Concealed, Concealer
from splatwire.conceal.coarse import Coarse
from splatwire.conceal.conceal import conceal, concealed
from splatwire.conceal.drop import Drop
from splatwire.conceal.grow import Grow
from splatwire.conceal.registry import concealer_names, create_concealer, register_concealer
from splatwire.conceal.scene_free import SceneFree
from splatwire.conceal.sketch import Sketch

__all__ = [
    "Coarse",
    "Concealed",
    "Concealer",
    "Drop",
    "Grow",
    "SceneFree",
    "Sketch",
    "conceal",
    "concealed",
    "concealer_names",
    "create_concealer",
    "register_concealer",
]
