"""Main function of an evaluation: prepares inputs, computes missing results, and collects all results."""

import hashlib
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.evaluation.study.definition import Loss, Study
from splatwire.evaluation.study.engines import Engine, Event
from splatwire.evaluation.study.inputs import PreparedScene, check_scenes, prepare_scene
from splatwire.evaluation.study.records import Record, hardest
from splatwire.evaluation.study.references import Progress
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Cell, Unit, list_cells
from splatwire.metrics.lpips import load_lpips
from splatwire.metrics.lpips_files import find_lpips_files
from splatwire.metrics.registry import LPIPS_SCALED

ABSENT = "weights absent"
LPIPS_OF_MASKED = "both pictures black outside the masks, mean over the whole picture"
"""Explanation in reports of how LPIPS treats masked pixels; its receptive fields extend beyond the mask."""


@dataclass(frozen=True)
class ReportImages:
    """Selection of a scene's pictures in a report: one loss model, and some views.

    Attributes:
        loss: Loss model; None to show images without loss only.
        seed: Seed of the loss model.
        views: Indices of the views in which the baseline method has the lowest PSNR, lowest first.
    """

    loss: Loss | None
    seed: int | None
    views: tuple[int, ...]

    def shows(self, cell: Cell) -> bool:
        """Returns True if the report shows images of a task: without loss, or with the selected loss model and seed."""
        return cell.loss is None or (cell.loss, cell.seed) == (self.loss, self.seed)


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Results of an evaluation.

    Attributes:
        study: The definition.
        scenes: The prepared scenes, by name.
        cells: All combinations of row, loss model and seed, with their tasks.
        records: Scores of each view of every task, by the key of the task. Views are in their original order.
        report_images: Selection of the images that the report shows (loss model, seed and views), by name of the scene.
        skipped: Sentences for the report, each with a method or metric that was not evaluated and the reason.
        skipped_rows: Keys of the rows that were not evaluated, by name of the scene.
        num_computed: Number of tasks computed in this run.
        num_reused: Number of tasks whose results were in the store.
        num_lost_workers: Number of worker processes that died.
    """

    study: Study
    scenes: Mapping[str, PreparedScene]
    cells: tuple[Cell, ...]
    records: Mapping[str, list[Record]]
    report_images: Mapping[str, ReportImages]
    skipped: tuple[str, ...]
    skipped_rows: Mapping[str, tuple[str, ...]]
    num_computed: int
    num_reused: int
    num_lost_workers: int

    @property
    def lpips_note(self) -> str:
        """Remark on LPIPS for the report: why values are missing, or which views and pixels are measured.

        May be empty.
        """
        if LPIPS_SCALED.keys().isdisjoint(self.study.metrics):
            return ""
        if not any(cell.unit.lpips_digest for cell in self.cells):
            return ABSENT
        count, most = self.study.lpips_views, max(len(records) for records in self.records.values())
        notes = [] if count is None or count >= most else [f"mean of {count} of {most} views"]
        masked = any(scene.references.masked for scene in self.scenes.values())
        return ", ".join([*notes, *([LPIPS_OF_MASKED] if masked else [])])

    def merged(self) -> list[dict[str, Any]]:
        """Returns the scores of each view in each task as a flat list, with the method's key and label."""
        return [
            {"study": self.study.name, "row": cell.row.key, "label": cell.row.label, **record.row()}
            for cell in self.cells
            for record in self.records[cell.unit.key]
        ]


@checked
def run_study(study: Study, store: Store, engine: Engine, progress: Progress) -> StudyResult:
    """Runs an evaluation; results that the store already has are not computed again.

    Args:
        study: The definition.
        store: Store for all results.
        engine: Engine that executes the tasks.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        SplatwireError: If a scene cannot be prepared or a task fails; results of finished tasks stay in the store.
    """
    # The baseline is computed first. Images of all methods are stored for the views with the baseline's lowest PSNR.
    with store.locked():
        check_scenes(study, store)
        lpips = lpips_digest()
        scenes = {entry.name: prepare_scene(study, entry, store, progress) for entry in study.scenes}
        cells = list_cells(study, scenes, lpips_digest=lpips)
        _check_scenes(study, scenes, cells)
        image_tasks = _hardest_view_tasks(study, cells)
        runner = _TaskRunner(store, engine, progress, len({c.unit.key for c in cells if not store.has(c.unit.key)}))
        others = [c for c in cells if c.seed not in (None, study.seeds[0]) and c not in image_tasks]
        runner.run(
            [*(c.unit for c in _by_mask(others)), *(_storing_hardest_views(study, store, c.unit) for c in image_tasks)]
        )
        report_images = {
            name: _choose_images(study, store, [c for c in image_tasks if c.scene == name]) for name in scenes
        }
        rest = [c for c in _by_mask(cells, image_tasks) if c not in image_tasks and c not in others]
        runner.run([_with_pictures(report_images[c.scene], c) for c in rest])
        records = {cell.unit.key: store.records(cell.unit.key) for cell in cells}
    return StudyResult(
        study=study,
        scenes=scenes,
        cells=tuple(cells),
        records=records,
        report_images=report_images,
        skipped=_skipped(study, scenes, lpips),
        skipped_rows={
            name: tuple(row.key for row in study.rows if scene.why_unsupported(row)) for name, scene in scenes.items()
        },
        num_computed=runner.num_done,
        num_reused=len(records) - runner.num_done,
        num_lost_workers=runner.num_lost,
    )


@dataclass
class _TaskRunner:
    """Executes the tasks whose results are not in the store yet; counts executed tasks and dead workers."""

    store: Store
    engine: Engine
    progress: Progress
    num_expected: int
    num_done: int = 0
    num_lost: int = 0

    def run(self, units: Sequence[Unit]) -> None:
        missing = list({unit.key: unit for unit in units if not unit.is_done(self.store)}.values())
        if missing:
            self.engine.run(self.store, missing, self._listen)

    def _listen(self, event: Event) -> None:
        self.num_lost += event.lost_worker
        self.num_done += not event.lost_worker
        self.progress(f"{self.num_expected} units of work", min(1.0, self.num_done / max(1, self.num_expected)))


def _check_scenes(study: Study, scenes: Mapping[str, PreparedScene], cells: Sequence[Cell]) -> None:
    """Checks that at least one method can be evaluated on each scene.

    Raises:
        InvalidValueError: If no row can run on a scene.
    """
    running = {cell.scene for cell in cells}
    for name, scene in scenes.items():
        if name not in running:
            raise InvalidValueError(f"no row can run on scene '{name}': {scene.why_unsupported(study.rows[0])}")


def _hardest_view_tasks(study: Study, cells: Sequence[Cell]) -> list[Cell]:
    """Returns the tasks that determine which views the report shows: one task for each scene and loss model.

    The report shows the views with the lowest PSNR in these tasks. The method of each task is the baseline or, without
    a baseline, the first method with losses.
    """
    # A task of the baseline, or of the first row with losses if there is no baseline.
    image_tasks = []
    for scene in dict.fromkeys(cell.scene for cell in cells):
        own = [cell for cell in cells if cell.scene == scene and cell.seed in (None, study.seeds[0])]
        own = [cell for cell in own if not cell.row.lossless] or own
        for loss in dict.fromkeys(cell.loss for cell in own):
            group = [cell for cell in own if cell.loss == loss]
            image_tasks.append(next((cell for cell in group if cell.row.key == study.baseline), group[0]))
    return image_tasks


def _storing_hardest_views(study: Study, store: Store, unit: Unit) -> Unit:
    if store.has(unit.key):
        return replace(unit, pictures=hardest(store.records(unit.key), study.picture_views))
    return replace(unit, hardest=study.picture_views)


def _choose_images(study: Study, store: Store, image_tasks: Sequence[Cell]) -> ReportImages:
    """Selects the packet loss and the views whose pictures the report shows for a scene.

    The report shows the loss with the lowest mean PSNR, and those views in which the PSNR under this loss is lowest.

    Args:
        study: Definition of the evaluation, with the number of views to show.
        store: Store with the results of the tasks.
        image_tasks: One finished task of the scene for each loss model, from `_hardest_view_tasks`. The PSNR of these
            tasks is compared.
    """
    # The views with the lowest PSNR of this task are chosen, to show the effect of losses.

    def level(cell: Cell) -> float:
        values = [r.psnr for r in store.records(cell.unit.key) if r.psnr is not None and math.isfinite(r.psnr)]
        return statistics.fmean(values) if values else math.inf

    hardest_task = min(image_tasks, key=level)
    return ReportImages(
        hardest_task.loss, hardest_task.seed, hardest(store.records(hardest_task.unit.key), study.picture_views)
    )


def _with_pictures(images: ReportImages, cell: Cell) -> Unit:
    return replace(cell.unit, pictures=images.views) if images.shows(cell) else cell.unit


def _by_mask(cells: Sequence[Cell], first: Sequence[Cell] = ()) -> list[Cell]:
    """Sorts tasks by stream and loss mask, so that each received stream is decoded only once.

    Args:
        cells: Tasks to sort.
        first: Tasks whose streams and loss masks come first in the result.
    """
    rank: dict[tuple[str, str], int] = {}
    for cell in (*first, *cells):
        rank.setdefault((cell.unit.stream.digest, cell.unit.mask_digest), len(rank))
    return sorted(cells, key=lambda cell: rank[(cell.unit.stream.digest, cell.unit.mask_digest)])


def lpips_digest() -> str:
    """Returns a hash of the LPIPS weights; empty without weights."""
    files = find_lpips_files()
    if files is None:
        return ""
    lpips = load_lpips(*files)
    digest = hashlib.sha256(lpips.network.encode())
    for weight in (*lpips.linear, *(tensor for _, pair in sorted(lpips.convolutions.items()) for tensor in pair)):
        digest.update(weight.tobytes())
    return digest.hexdigest()[:16]


def _skipped(study: Study, scenes: Mapping[str, PreparedScene], lpips: str) -> tuple[str, ...]:
    notes = [
        f"Row '{row.label}' did not run on {name}: {reason}."
        for name, scene in scenes.items()
        for row in study.rows
        if (reason := scene.why_unsupported(row))
    ]
    if not lpips and not LPIPS_SCALED.keys().isdisjoint(study.metrics):
        notes.append("LPIPS was not computed: its weights are absent (set SPLATWIRE_LPIPS_DIR).")
    return tuple(notes)
