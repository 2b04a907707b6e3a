"""Pictures for the report: the hardest views of each scene and every row, as the workers kept them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.evaluate.pixels import png_bytes, png_pixels, to_pixels
from splatwire.evaluate.study.run import StudyResult
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Cell
from splatwire.files.names import distinct_names
from splatwire.files.whole import write_whole


@dataclass(frozen=True, eq=False)
class Shot:
    """One view of one row.

    Attributes:
        label: Label of the row.
        pixels: RGB, uint8, H W 3.
        psnr: Decibels; None if not measured.
    """

    label: str
    pixels: np.ndarray
    psnr: float | None


@dataclass(frozen=True, eq=False)
class ViewPictures:
    """One view of a scene under every row.

    Attributes:
        scene: Name of the scene.
        view: Name of the view.
        loss: The loss and seed of the pictures.
        source: What the reference is.
        reference: RGB, uint8, H W 3.
        shots: One per row.
        loss_maps: Where anchors were lost, by packetization; in the hardest view only.
    """

    scene: str
    view: str
    loss: str
    source: str
    reference: np.ndarray
    shots: tuple[Shot, ...]
    loss_maps: dict[str, np.ndarray]


def take_pictures(result: StudyResult, store: Store) -> list[ViewPictures]:
    """Reads the pictures of a report from the store of a run."""
    found = []
    for name, look in result.looks.items():
        cells = [cell for cell in result.cells if cell.scene == name and look.shows(cell)]
        references = result.scenes[name].references
        views = references.open(store.root)
        loss = "" if look.loss is None else f"{look.loss.label}, seed {look.seed}"
        for view in look.views:
            shots = tuple(_shot(result, store, cell, view) for cell in cells)
            maps = {c.row.variant: c.unit.loss_map(view) for c in cells if c.row.erode is None}
            there = {variant: store.root / file for variant, file in maps.items() if (store.root / file).is_file()}
            pixels = {variant: png_pixels(path.read_bytes()) for variant, path in there.items()}
            reference = to_pixels(views.reference(view))
            found.append(
                ViewPictures(name, views.cameras.names[view], loss, references.source, reference, shots, pixels)
            )
    return found


def _shot(result: StudyResult, store: Store, cell: Cell, view: int) -> Shot:
    pixels = png_pixels((store.root / cell.unit.picture(view)).read_bytes())
    return Shot(cell.row.label, pixels, result.records[cell.unit.key][view].psnr)


def save_pictures(found: list[ViewPictures], folder: Path) -> None:
    """Writes pictures as PNG files, no two under one name.

    Args:
        found: The pictures.
        folder: Where to; made if it is not there.
    """
    pictures: dict[str, np.ndarray] = {}
    for view in found:
        start = f"{view.scene}\0{view.view}\0"  # no name has this character, so no two begin alike
        pictures[f"{start}reference"] = view.reference
        pictures |= {f"{start}{shot.label}": shot.pixels for shot in view.shots}
        pictures |= {f"{start}loss_map\0{variant}": pixels for variant, pixels in view.loss_maps.items()}
    for file, pixels in zip(distinct_names(pictures), pictures.values(), strict=True):
        write_whole(folder / f"{file}.png", png_bytes(pixels))
