"""A protocol from its file to its results: prepare, run what is missing, gather."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from splatwire.errors import SplatwireError
from splatwire.evaluate.study.definition import Study
from splatwire.evaluate.study.engines import Engine, Event
from splatwire.evaluate.study.inputs import PreparedScene, prepare_scene
from splatwire.evaluate.study.records import records_from_bytes
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Cell, code_digest, list_cells, what_is_missing
from splatwire.metrics import find_lpips

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Everything that a protocol found.

    Attributes:
        study: The protocol.
        scenes: The prepared scenes, by name.
        cells: Every row under every mask.
        records: Records of every unit, by its key, views in order.
        skipped: What did not run, and why.
        num_computed: Units that were computed now.
        num_reused: Units that the store had.
        num_lost_workers: Workers that died on the way.
    """

    study: Study
    scenes: dict[str, PreparedScene]
    cells: tuple[Cell, ...]
    records: dict[str, list[dict[str, Any]]]
    skipped: tuple[str, ...]
    num_computed: int
    num_reused: int
    num_lost_workers: int

    def merged(self) -> list[dict[str, Any]]:
        """All records in the order of the tables, each with its row; none is there twice."""
        return [
            {"study": self.study.name, "row": cell.row.key, "label": cell.row.label, **record}
            for cell in self.cells
            for record in self.records[cell.unit.key]
        ]


def run_study(study: Study, store: Store, engine: Engine, progress: Progress) -> StudyResult:
    """Runs a protocol; whatever the store has is not computed again.

    Args:
        study: The protocol.
        store: Where everything goes.
        engine: What computes.
        progress: Called with what is being done and the share of it that is done.

    Raises:
        SplatwireError: If a scene cannot be prepared or a unit fails; finished units stay in the store.
    """
    with store.locked():
        code, lpips = code_digest(), lpips_digest()
        scenes = {entry.name: prepare_scene(study, entry, store, code, progress) for entry in study.scenes}
        cells = list_cells(study, scenes, lpips_digest=lpips)
        units = {cell.unit.key: cell.unit for cell in cells}
        missing = store.missing(units)
        counts = {"done": 0, "lost": 0}

        def listen(event: Event) -> None:
            counts["lost" if event.lost_worker else "done"] += 1
            progress(f"{len(missing)} units of work", counts["done"] / len(missing))

        if missing:
            engine.run(store, [units[key] for key in missing], listen)
        records = {key: read_unit(store, key) for key in units}
    return StudyResult(
        study=study,
        scenes=scenes,
        cells=tuple(cells),
        records=records,
        skipped=_skipped(study, scenes, lpips),
        num_computed=len(missing),
        num_reused=len(units) - len(missing),
        num_lost_workers=counts["lost"],
    )


def read_unit(store: Store, key: str) -> list[dict[str, Any]]:
    """Reads the records of a unit.

    Raises:
        SplatwireError: If they are not there, or not of this unit.
    """
    path = store.unit_path(key)
    try:
        records = records_from_bytes(path.read_bytes(), str(path))
    except FileNotFoundError as error:
        raise SplatwireError(f"{path} is missing although its worker said that it is done") from error
    if not records or any(record["unit"] != key for record in records):
        raise SplatwireError(f"{path} does not hold the records of its unit: remove it and start again")
    return records


def lpips_digest() -> str:
    """Digest of the LPIPS weights that the environment names; empty if there are none."""
    lpips = find_lpips()
    if lpips is None:
        return ""
    digest = hashlib.sha256(lpips.network.encode())
    for weight in lpips.linear:
        digest.update(weight.numpy().tobytes())
    for key, (weight, bias) in sorted(lpips.convolutions.items()):
        digest.update(f"{key}:{float(weight.double().sum())!r}:{float(bias.double().sum())!r}".encode())
    return digest.hexdigest()[:16]


def _skipped(study: Study, scenes: dict[str, PreparedScene], lpips: str) -> tuple[str, ...]:
    notes = [
        f"Row '{row.label}' did not run on {scene.name}: {reason}."
        for scene in scenes.values()
        for row in study.rows
        if (reason := what_is_missing(row, scene))
    ]
    if "lpips" in study.metrics and not lpips:
        notes.append("LPIPS was not computed: its weights are absent (set SPLATWIRE_LPIPS_DIR).")
    return tuple(notes)
