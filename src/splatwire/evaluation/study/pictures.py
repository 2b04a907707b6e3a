"""Images for the report: the views of each scene with the lowest PSNR, for every method."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.evaluation.pixels import png_bytes, to_pixels
from splatwire.evaluation.study.run import StudyResult
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Cell
from splatwire.files.atomic_write import atomic_write
from splatwire.files.names import distinct_names


@dataclass(frozen=True, eq=False)
class Shot:
    """Image of one view as displayed by one method.

    Attributes:
        label: Label of the method.
        pixels: RGB, uint8, (H, W, 3).
        psnr: PSNR in decibels; None if not measured.
    """

    label: str
    pixels: np.ndarray
    psnr: float | None


@dataclass(frozen=True, eq=False)
class ViewPictures:
    """Images of one view of a scene by all methods.

    Attributes:
        scene: Name of the scene.
        view: Name of the view.
        loss: Description of the loss model and the seed.
        source: Description of the references for reports, such as `photos` or `renders of the complete scene`.
        reference: RGB, uint8, (H, W, 3).
        shots: One image per method.
        loss_maps: Images of received and lost elements drawn as dots, by name of the packetization.
    """

    scene: str
    view: str
    loss: str
    source: str
    reference: np.ndarray
    shots: tuple[Shot, ...]
    loss_maps: dict[str, np.ndarray]


def take_pictures(result: StudyResult, store: Store) -> list[ViewPictures]:
    """Reads the images for a report from the store."""
    pictures = []
    for name, images in result.report_images.items():
        cells = [cell for cell in result.cells if cell.scene == name and images.shows(cell)]
        references = result.scenes[name].references
        views = references.open(store.root)
        loss = "" if images.loss is None else f"{images.loss.label}, seed {images.seed}"
        for view in images.views:
            shots = tuple(_shot(result, store, cell, view) for cell in cells)
            maps = {c.row.variant: c.unit.loss_map(view) for c in cells if c.row.erode is None}
            there = {variant: file for variant, file in maps.items() if (store.root / file).is_file()}
            pixels = {variant: store.picture(file) for variant, file in there.items()}
            reference = to_pixels(views.reference(view))
            pictures.append(
                ViewPictures(name, views.cameras.names[view], loss, references.source, reference, shots, pixels)
            )
    return pictures


def _shot(result: StudyResult, store: Store, cell: Cell, view: int) -> Shot:
    pixels = store.picture(cell.unit.picture(view))
    return Shot(cell.row.label, pixels, result.records[cell.unit.key][view].psnr)


def save_pictures(view_pictures: list[ViewPictures], folder: Path) -> None:
    """Writes images as PNG files with distinct names.

    Args:
        view_pictures: The images.
        folder: Output folder; created if missing.
    """
    pictures: dict[str, np.ndarray] = {}
    for view in view_pictures:
        start = f"{view.scene}\0{view.view}\0"  # names cannot contain this character, so prefixes are unique
        pictures[f"{start}reference"] = view.reference
        pictures |= {f"{start}{shot.label}": shot.pixels for shot in view.shots}
        pictures |= {f"{start}loss_map\0{variant}": pixels for variant, pixels in view.loss_maps.items()}
    for file, pixels in zip(distinct_names(pictures), pictures.values(), strict=True):
        atomic_write(folder / f"{file}.png", png_bytes(pixels), parents=True)
