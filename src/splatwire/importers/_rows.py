"""Anchors of other programs, those that can be drawn."""

from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.scene import Anchors
from splatwire.scene.rows import rows_of_anchors


def drawable_anchors(anchors: Anchors, path: Path) -> Anchors:
    """Leaves out anchors that draw nothing or cannot be drawn, which is logged (`splatwire.scene.rows`).

    Args:
        anchors: The anchors, a row for each of the file's.
        path: The file, for messages.

    Raises:
        DatasetError: If none is left.
    """
    rows = rows_of_anchors(anchors)
    rows.tell(path, "anchors")
    if not bool(rows.kept.any()):
        found = f"{rows.num_invisible:,} have no offset, {rows.num_invalid:,} cannot be drawn"
        raise DatasetError(f"{path}: none of its {anchors.num_anchors:,} anchors is left: {found}")
    return anchors if rows.complete else anchors.select(rows.kept)
