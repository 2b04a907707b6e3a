"""Units of work: one row under one mask, named by everything that its result depends on."""

import functools
import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import splatwire
from splatwire.evaluate.study.definition import WEIGHTS, Loss, Row, Study, canonical
from splatwire.evaluate.study.inputs import PreparedScene

_ROOMS = ("channel", "codec", "conceal", "data", "entropy", "metrics", "model", "ops", "packets", "render", "scene")
_OWN = (
    "evaluate/views.py",
    *(f"evaluate/study/{name}.py" for name in ("masks", "work", "records", "inputs", "references")),
)


@dataclass(frozen=True)
class Unit:
    """One row under one mask.

    Attributes:
        scene: Name of the scene.
        stream: Path of the encoded stream within the store.
        stream_digest: Digest of its content.
        views: Path of the folder of references within the store.
        views_digest: Digest of their content.
        mask_digest: Digest of which packets arrive; empty without loss.
        loss: The loss; None without.
        seed: Seed of the mask; None without loss.
        conceal: The concealer.
        options: Its options, canonical JSON.
        weights: File of its weights; empty if it has none.
        weights_digest: Digest of their content.
        erode: The one attribute that lost anchors lose; None for all.
        metrics: What is measured.
        lpips_digest: Digest of the metric's weights; empty if they are absent or not asked for.
        lpips_views: Most views that LPIPS is computed on.
        renderer: Name of the renderer.
        code: Digest of the code that computes it.
    """

    scene: str
    stream: str
    stream_digest: str
    views: str
    views_digest: str
    mask_digest: str
    loss: Loss | None
    seed: int | None
    conceal: str
    options: str
    weights: str
    weights_digest: str
    erode: str | None
    metrics: tuple[str, ...]
    lpips_digest: str
    lpips_views: int | None
    renderer: str
    code: str

    @property
    def key(self) -> str:
        """Name of the unit: equal for equal results. Paths do not count, contents do."""
        content = asdict(self)
        for path in ("stream", "views", "weights"):
            del content[path]
        return hashlib.sha256(canonical(content).encode()).hexdigest()[:32]

    @property
    def concealer(self) -> str:
        """The concealer, with the path of its weights."""
        return self.conceal.replace(WEIGHTS, self.weights)


@dataclass(frozen=True)
class Cell:
    """A unit and the place of its result in the tables."""

    scene: str
    row: Row
    loss: Loss | None
    seed: int | None
    unit: Unit


def list_cells(study: Study, scenes: Mapping[str, PreparedScene], *, lpips_digest: str) -> list[Cell]:
    """Lists everything that a protocol needs, long work first.

    Args:
        study: The protocol.
        scenes: What was prepared, by name of the scene.
        lpips_digest: Digest of the LPIPS weights; empty if they are absent.
    """
    cells = []
    code = code_digest()
    for scene in scenes.values():
        for row in study.rows:
            if what_is_missing(row, scene):
                continue
            losses: list[tuple[Loss | None, int | None]] = [(None, None)]
            if not row.lossless:
                losses = [(loss, seed) for loss in study.losses for seed in study.seeds]
            for loss, seed in losses:
                cells.append(_cell(study, scene, row, loss, seed, lpips_digest, code))
    return cells


def _cell(
    study: Study, scene: PreparedScene, row: Row, loss: Loss | None, seed: int | None, lpips_digest: str, code: str
) -> Cell:
    stream = scene.streams[row.variant]
    mask = "" if loss is None or seed is None else scene.masks[(row.variant, loss, seed)].digest
    uses_weights = row.needs_weights
    unit = Unit(
        scene=scene.name,
        stream=stream.path,
        stream_digest=stream.digest,
        views=scene.views,
        views_digest=scene.views_digest,
        mask_digest=mask,
        loss=loss,
        seed=seed,
        conceal=row.conceal,
        options=row.options,
        weights=scene.weights if uses_weights else "",
        weights_digest=scene.weights_digest if uses_weights else "",
        erode=row.erode,
        metrics=study.metrics,
        lpips_digest=lpips_digest if "lpips" in study.metrics else "",
        lpips_views=study.lpips_views,
        renderer=study.renderer,
        code=code,
    )
    return Cell(scene.name, row, loss, seed, unit)


@functools.lru_cache(maxsize=1)
def code_digest() -> str:
    """Digest of the source that results depend on: results of other code are never taken for this one's."""
    root = Path(splatwire.__file__).parent
    files = [path for room in _ROOMS for path in sorted((root / room).rglob("*.py"))] + [root / name for name in _OWN]
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def what_is_missing(row: Row, scene: PreparedScene) -> str:
    """Why a row cannot run on a scene; empty if it can."""
    if row.needs_weights and not scene.weights:
        return "it has no calibrated weights (splatwire calibrate makes them)"
    absent = [name for name in row.sections if name not in scene.sections]
    return f"it has no section '{absent[0]}' (splatwire calibrate adds it)" if absent else ""
