"""Scenes larger than a view: levels of coarser Gaussians, and which tiles a view needs first."""

from splatwire.levels.encoding import encode_levels
from splatwire.levels.tiles import tiles_of
from splatwire.packets.tiles import Tiles
from splatwire.packets.view import Cut, Look, cut_of

__all__ = ["Cut", "Look", "Tiles", "cut_of", "encode_levels", "tiles_of"]
