"""Pictures for the report: the hardest views of each scene and every row, under the loss that tells rows apart."""

import io
import statistics
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from splatwire.evaluate.lossmap import draw_loss_map
from splatwire.evaluate.runner import Progress, to_pixels
from splatwire.evaluate.study.definition import Loss
from splatwire.evaluate.study.run import StudyResult
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Cell
from splatwire.evaluate.study.work import Workshop, concealed
from splatwire.evaluate.views import views_of


@dataclass(frozen=True, eq=False)
class Shot:
    """One view of one row.

    Attributes:
        label: Label of the row.
        pixels: RGB, uint8, H W 3.
        psnr: Decibels.
    """

    label: str
    pixels: np.ndarray
    psnr: float


@dataclass(frozen=True, eq=False)
class ViewPictures:
    """One view of a scene under every row.

    Attributes:
        scene: Name of the scene.
        view: Name of the view.
        loss: The loss and seed of the pictures.
        reference: RGB, uint8, H W 3.
        shots: One per row.
        loss_maps: Where anchors were lost, by packetization.
    """

    scene: str
    view: str
    loss: str
    reference: np.ndarray
    shots: tuple[Shot, ...]
    loss_maps: dict[str, np.ndarray]


def take_pictures(result: StudyResult, store: Store, progress: Progress) -> list[ViewPictures]:
    """Draws the pictures of a report, or takes them from the store.

    Args:
        result: What the protocol found.
        store: Its store; pictures are kept there.
        progress: Called with what is being done and the share of it that is done.
    """
    found, workshop = [], Workshop(store)
    for scene in result.scenes:
        cells = [cell for cell in result.cells if cell.scene == scene]
        loss = _telling_loss(result, cells)
        shown = [c for c in cells if c.row.lossless or (c.loss, c.seed) == (loss, result.study.seeds[0])]
        hard = _hardest(result, shown)
        for index, view in enumerate(hard):
            found.append(_one_view(result, workshop, shown, view, maps=index == 0))
            progress(f"{scene}: drawing pictures", (index + 1) / len(hard))
    return found


def _telling_loss(result: StudyResult, cells: list[Cell]) -> Loss:
    """The loss under which the rows differ most; pictures of 1 % lost packets would show nothing."""

    def difference(loss: Loss) -> float:
        scores = [
            [r["psnr"] for r in result.records[c.unit.key] if r["psnr"] is not None] for c in cells if c.loss == loss
        ]
        means = [statistics.fmean(each) for each in scores if each]  # a view without loss has no finite PSNR
        return max(means) - min(means) if means else -1.0

    return max(result.study.losses, key=difference)


def _hardest(result: StudyResult, shown: list[Cell]) -> list[int]:
    """The views with the lowest PSNR of the baseline, or of the first row with losses."""
    lossy = [cell for cell in shown if not cell.row.lossless]
    if not lossy:
        return []
    cell = next((cell for cell in lossy if cell.row.key == result.study.baseline), lossy[0])
    records = result.records[cell.unit.key]
    if records[0]["psnr"] is None:
        return [0]
    order = sorted(range(len(records)), key=lambda view: records[view]["psnr"])
    return order[: result.study.picture_views]


def _one_view(result: StudyResult, workshop: Workshop, shown: list[Cell], view: int, *, maps: bool) -> ViewPictures:
    views = workshop.views(shown[0].unit)
    reference = views.reference(view)
    loss_maps: dict[str, np.ndarray] = {}
    shots = []
    for cell in shown:
        pixels = _drawn(workshop, cell, view)
        psnr = result.records[cell.unit.key][view]["psnr"]
        shots.append(Shot(cell.row.label, pixels, float("nan") if psnr is None else psnr))
        if maps and cell.loss is not None and cell.row.erode is None and cell.row.variant not in loss_maps:
            partial = workshop.received(cell.unit)[1]
            anchors = partial.scene.anchors
            loss_maps[cell.row.variant] = draw_loss_map(anchors, partial.erasures.known, views.cameras, view, reference)
    lossy = next(cell for cell in shown if cell.loss is not None)
    assert lossy.loss is not None
    loss = f"{lossy.loss.label}, seed {lossy.seed}"
    names = views.cameras.names
    return ViewPictures(shown[0].scene, names[view], loss, to_pixels(reference), tuple(shots), loss_maps)


def _drawn(workshop: Workshop, cell: Cell, view: int) -> np.ndarray:
    name = f"pictures/{cell.unit.key}_{view}.png"
    path = workshop.store.root / name
    if path.is_file():
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    unit, views = cell.unit, workshop.views(cell.unit)
    scene = concealed(workshop.received(unit)[1], unit)
    image = next(iter(views_of(scene, views.cameras.select([view]), unit.renderer, views.background)))
    pixels = to_pixels(views.compared(view, image).image[0])
    workshop.store.write(name, png_bytes(pixels))
    return pixels


def png_bytes(pixels: np.ndarray) -> bytes:
    """RGB, uint8, as a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def save_pictures(found: list[ViewPictures], folder: Path) -> None:
    """Writes pictures as PNG files.

    Args:
        found: The pictures.
        folder: Where to; made if it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for view in found:
        start = f"{safe(view.scene)}_{safe(view.view)}"
        (folder / f"{start}_reference.png").write_bytes(png_bytes(view.reference))
        for shot in view.shots:
            (folder / f"{start}_{safe(shot.label)}.png").write_bytes(png_bytes(shot.pixels))
        for variant, pixels in view.loss_maps.items():
            (folder / f"{start}_loss_map_{safe(variant)}.png").write_bytes(png_bytes(pixels))


def safe(name: str) -> str:
    """A file name without folders or surprises."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip("._")[:80] or "unnamed"
