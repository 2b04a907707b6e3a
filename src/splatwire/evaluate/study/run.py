"""An evaluation from what it compares to its results: prepare, run what is missing, gather."""

import hashlib
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from splatwire.errors import InvalidValueError
from splatwire.evaluate.study.definition import Loss, Study
from splatwire.evaluate.study.engines import Engine, Event
from splatwire.evaluate.study.inputs import PreparedScene, prepare_scene
from splatwire.evaluate.study.records import Record, hardest
from splatwire.evaluate.study.references import Progress
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Cell, Unit, list_cells
from splatwire.metrics.lpips_files import find_lpips_files

ABSENT = "weights absent"
LPIPS_OF_MASKED = "both pictures black outside the masks, mean over the whole picture"
"""How LPIPS, whose features look far around, treats what does not count."""


@dataclass(frozen=True)
class Look:
    """What the pictures of a scene show.

    Attributes:
        loss: The loss; None where nothing is sent.
        seed: Its seed.
        views: The hardest views, hardest first.
    """

    loss: Loss | None
    seed: int | None
    views: tuple[int, ...]

    def shows(self, cell: Cell) -> bool:
        """Whether a cell is among the pictures; without loss, it stands for comparison."""
        return cell.loss is None or (cell.loss, cell.seed) == (self.loss, self.seed)


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Everything that an evaluation found.

    Attributes:
        study: What was compared.
        scenes: The prepared scenes, by name.
        cells: Every row under every mask.
        records: Records of every unit, by its key, views in order.
        looks: What the pictures show, by name of the scene.
        skipped: What did not run, and why.
        skipped_rows: Key of each row that did not run, by name of the scene.
        num_computed: Units that were computed now.
        num_reused: Units that the store had.
        num_lost_workers: Workers that died on the way.
    """

    study: Study
    scenes: Mapping[str, PreparedScene]
    cells: tuple[Cell, ...]
    records: Mapping[str, list[Record]]
    looks: Mapping[str, Look]
    skipped: tuple[str, ...]
    skipped_rows: Mapping[str, tuple[str, ...]]
    num_computed: int
    num_reused: int
    num_lost_workers: int

    @property
    def lpips_note(self) -> str:
        """Why there is no LPIPS, or on which views and pixels it is; empty if it is on all, or was not asked for."""
        if "lpips" not in self.study.metrics:
            return ""
        if not any(cell.unit.lpips_digest for cell in self.cells):
            return ABSENT
        count, most = self.study.lpips_views, max(len(records) for records in self.records.values())
        notes = [] if count is None or count >= most else [f"mean of {count} of {most} views"]
        masked = any(scene.references.masked for scene in self.scenes.values())
        return ", ".join([*notes, *([LPIPS_OF_MASKED] if masked else [])])

    def merged(self) -> list[dict[str, Any]]:
        """All records in the order of the tables, each with its row; none is there twice."""
        return [
            {"study": self.study.name, "row": cell.row.key, "label": cell.row.label, **vars(record)}
            for cell in self.cells
            for record in self.records[cell.unit.key]
        ]


def run_study(study: Study, store: Store, engine: Engine, progress: Progress) -> StudyResult:
    """Runs an evaluation; whatever the store has is not computed again.

    The judges run before the rows that are shown beside them: their hardest views are those of which pictures are kept.

    Args:
        study: What is compared.
        store: Where everything goes.
        engine: What computes.
        progress: Called with what is being done and the share of it that is done.

    Raises:
        SplatwireError: If a scene cannot be prepared or a unit fails; finished units stay in the store.
    """
    with store.locked():
        lpips = lpips_digest()
        scenes = {entry.name: prepare_scene(study, entry, store, progress) for entry in study.scenes}
        cells = list_cells(study, scenes, lpips_digest=lpips)
        _check_scenes(study, scenes, cells)
        judges = _judges(study, cells)
        shift = _Shift(store, engine, progress, len({c.unit.key for c in cells if not store.has(c.unit.key)}))
        others = [c for c in cells if c.seed not in (None, study.seeds[0]) and c not in judges]
        shift.run([*(c.unit for c in _by_mask(others)), *(_judging(study, store, c.unit) for c in judges)])
        looks = {name: _look(study, store, [c for c in judges if c.scene == name]) for name in scenes}
        rest = [c for c in _by_mask(cells, judges) if c not in judges and c not in others]
        shift.run([_shown(looks[c.scene], c) for c in rest])
        records = {cell.unit.key: store.records(cell.unit.key) for cell in cells}
    return StudyResult(
        study=study,
        scenes=scenes,
        cells=tuple(cells),
        records=records,
        looks=looks,
        skipped=_skipped(study, scenes, lpips),
        skipped_rows={name: tuple(row.key for row in study.rows if scene.lacks(row)) for name, scene in scenes.items()},
        num_computed=shift.num_done,
        num_reused=len(records) - shift.num_done,
        num_lost_workers=shift.num_lost,
    )


@dataclass
class _Shift:
    """Has an engine run what is missing, and counts."""

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
    """Refuses a scene without a row that can run on it.

    Raises:
        InvalidValueError: If there is one.
    """
    running = {cell.scene for cell in cells}
    for name, scene in scenes.items():
        if name not in running:
            raise InvalidValueError(f"no row can run on scene '{name}': {scene.lacks(study.rows[0])}")


def _judges(study: Study, cells: Sequence[Cell]) -> list[Cell]:
    """For every scene and loss the cell that says which views are hard: the baseline, or the first one with losses."""
    judges = []
    for scene in dict.fromkeys(cell.scene for cell in cells):
        own = [cell for cell in cells if cell.scene == scene and cell.seed in (None, study.seeds[0])]
        own = [cell for cell in own if not cell.row.lossless] or own
        for loss in dict.fromkeys(cell.loss for cell in own):
            group = [cell for cell in own if cell.loss == loss]
            judges.append(next((cell for cell in group if cell.row.key == study.baseline), group[0]))
    return judges


def _judging(study: Study, store: Store, unit: Unit) -> Unit:
    if store.has(unit.key):
        return replace(unit, pictures=hardest(store.records(unit.key), study.picture_views))
    return replace(unit, hardest=study.picture_views)


def _look(study: Study, store: Store, judges: Sequence[Cell]) -> Look:
    """The loss that hurts most is shown: pictures of 1 % lost packets would show nothing."""

    def level(cell: Cell) -> float:
        values = [r.psnr for r in store.records(cell.unit.key) if r.psnr is not None and math.isfinite(r.psnr)]
        return statistics.fmean(values) if values else math.inf

    judge = min(judges, key=level)
    return Look(judge.loss, judge.seed, hardest(store.records(judge.unit.key), study.picture_views))


def _shown(look: Look, cell: Cell) -> Unit:
    return replace(cell.unit, pictures=look.views) if look.shows(cell) else cell.unit


def _by_mask(cells: Sequence[Cell], first: Sequence[Cell] = ()) -> list[Cell]:
    """Sorts cells so that those which share a received stream, which is decoded once, stand together."""
    place: dict[tuple[str, str], int] = {}
    for cell in (*first, *cells):
        place.setdefault((cell.unit.stream.digest, cell.unit.mask_digest), len(place))
    return sorted(cells, key=lambda cell: place[(cell.unit.stream.digest, cell.unit.mask_digest)])


def lpips_digest() -> str:
    """Digest of the LPIPS weights that the environment names; empty if there are none."""
    files = find_lpips_files()
    if files is None:
        return ""
    from splatwire.metrics.lpips import load_lpips  # needs torch

    lpips = load_lpips(*files)
    digest = hashlib.sha256(lpips.network.encode())
    for weight in (*lpips.linear, *(tensor for _, pair in sorted(lpips.convolutions.items()) for tensor in pair)):
        digest.update(weight.numpy().tobytes())
    return digest.hexdigest()[:16]


def _skipped(study: Study, scenes: Mapping[str, PreparedScene], lpips: str) -> tuple[str, ...]:
    notes = [
        f"Row '{row.label}' did not run on {name}: {reason}."
        for name, scene in scenes.items()
        for row in study.rows
        if (reason := scene.lacks(row))
    ]
    if "lpips" in study.metrics and not lpips:
        notes.append("LPIPS was not computed: its weights are absent (set SPLATWIRE_LPIPS_DIR).")
    return tuple(notes)
