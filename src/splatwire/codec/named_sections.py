"""Which named sections of the side information are for concealers: all but those that are listed here."""

from collections.abc import Mapping

from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.codec.metadata import SECTION as METADATA
from splatwire.codec.origin import SECTION as ORIGIN
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.viewpoint import EXTENT_SECTION as EXTENT
from splatwire.codec.viewpoint import SECTION as VIEWPOINT
from splatwire.codec.viewpoint import UP_SECTION as UP
from splatwire.packets.tile_index import SECTION as TILES

_OTHERS = (ANTIALIASED, BACKGROUND, TIERS, TIER_SIZES, PREVIEW, VIEWPOINT, UP, EXTENT, TILES, ORIGIN, METADATA)


def concealer_sections(sections: Mapping[str, bytes], *own: str) -> dict[str, bytes]:
    """Content of the sections that concealers may ask for, by name.

    Args:
        sections: All named sections.
        own: Those that a schema has for itself.
    """
    return {name: data for name, data in sections.items() if name not in (*_OTHERS, *own)}
