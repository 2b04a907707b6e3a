"""Detection of photos that are in the training and in the test split under different names."""

import hashlib
import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

LOG = logging.getLogger(__name__)
_PIECE = 1 << 20


def warn_of_copies(source: Path, names: Sequence[str], photos: Sequence[Path | None], is_test: Sequence[bool]) -> None:
    """Logs a warning if test photos have the same bytes as training photos, which makes test scores too high.

    Args:
        source: File or folder with the list of views, for messages.
        names: Name of each view.
        photos: Path of each view's photo; None if the file is missing.
        is_test: True for each view of the test split.
    """
    sizes: dict[int, list[int]] = {}
    for view, photo in enumerate(photos):
        if photo is not None:
            sizes.setdefault(photo.stat().st_size, []).append(view)
    copies = [pair for views in sizes.values() for pair in _copied_views(views, photos, is_test)]
    if copies:
        test, train = min(copies)
        LOG.warning(
            "%s: %d test views have the same photo as a training view, first %.120r and %.120r: remove one of each, "
            "because such views score too well",
            source, len(copies), names[test], names[train],
        )  # fmt: skip


def _copied_views(
    views: list[int], photos: Sequence[Path | None], is_test: Sequence[bool]
) -> Iterable[tuple[int, int]]:
    """Finds test views whose photo is identical to the photo of a training view.

    Args:
        views: Indices of the views to compare.
        photos: Path of each view's photo.
        is_test: True for each view of the test split.

    Yields:
        Index of such a test view, and index of the first training view with the same photo.
    """
    if len({is_test[view] for view in views}) < 2:
        return
    training: dict[bytes, int] = {}
    for view in (view for view in views if not is_test[view]):
        training.setdefault(_digest(photos[view]), view)
    for view in (view for view in views if is_test[view]):
        if (same := training.get(_digest(photos[view]))) is not None:
            yield view, same


def _digest(photo: Path | None) -> bytes:
    assert photo is not None
    digest = hashlib.sha256()
    with photo.open("rb") as file:
        while piece := file.read(_PIECE):
            digest.update(piece)
    return digest.digest()
