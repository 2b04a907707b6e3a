"""Levels of detail: coarser versions of a scene, divided into tiles, and selection of tiles for a view."""

from splatwire.bitstream.tile_selection import Cut, Viewpoint, cut_of
from splatwire.bitstream.tiles import Tiles
from splatwire.lod.encoding import encode_levels
from splatwire.lod.tiles import tiles_of

__all__ = ["Cut", "Tiles", "Viewpoint", "cut_of", "encode_levels", "tiles_of"]
