"""Selects the named sections (optional parts) of side information that loss concealers may read.

The other named sections are for the codec itself, such as the background colour or the metadata.
"""

from collections.abc import Mapping

from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.tile_index import SECTION as TILES
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.initial_view import EXTENT_SECTION as EXTENT
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.codec.initial_view import UP_SECTION as UP
from splatwire.codec.metadata import SECTION as METADATA
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.update.section import SECTION as UPDATE

_OTHERS = (
    ANTIALIASED,
    BACKGROUND_SECTION.name,
    TIERS,
    TIER_SIZES,
    PREVIEW,
    INITIAL_VIEW,
    UP,
    EXTENT,
    TILES,
    ORIGIN_SECTION.name,
    METADATA,
    UPDATE,
)


def concealer_sections(sections: Mapping[str, bytes], *excluded: str) -> dict[str, bytes]:
    """Returns the content of the named sections that loss concealers may read, by name.

    Named sections are optional parts of the side information.

    Args:
        sections: All named sections.
        *excluded: Names of sections to omit because only the codec reads them.
    """
    return {name: data for name, data in sections.items() if name not in (*_OTHERS, *excluded)}
