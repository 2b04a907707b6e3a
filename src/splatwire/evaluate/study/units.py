"""Units of work: one row under one mask, named by everything that its result depends on."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from splatwire.channel import LossMask
from splatwire.conceal.registry import concealer_files, concealer_package
from splatwire.evaluate.study.definition import WEIGHTS, Loss, Row, Study, canonical
from splatwire.evaluate.study.inputs import PreparedScene, PreparedStream
from splatwire.evaluate.study.records import CODE
from splatwire.evaluate.study.references import References, digest_of_files
from splatwire.evaluate.study.store import Store


@dataclass(frozen=True, eq=False)
class Unit:
    """One row under one mask, and which pictures of it are kept.

    Attributes:
        scene: Name of the scene.
        label: Label of the row.
        stream: What is sent, or scored.
        references: What pictures are compared with.
        mask: Which packets arrive; None where nothing is sent.
        loss: The loss; None without.
        seed: Seed of the mask; None without loss.
        conceal: The concealer.
        options: Its options.
        weights: File of the scene's weights; empty if it takes none.
        file_digest: Digests of the files of weights that the concealer reads, and the version of the package that
            brings it if that is not this one; empty without either.
        erode: The one attribute that lost anchors lose; None for all.
        metrics: What is measured.
        lpips_digest: Digest of the metric's weights; empty if they are absent or not asked for.
        lpips_views: Most views that LPIPS is computed on.
        renderer: Name of the renderer.
        pictures: Views whose pictures are kept.
        hardest: How many of its own hardest views are kept instead: others show the same ones.
    """

    scene: str
    label: str
    stream: PreparedStream
    references: References
    mask: LossMask | None
    loss: Loss | None
    seed: int | None
    conceal: str
    options: Mapping[str, Any]
    weights: str
    file_digest: str
    erode: str | None
    metrics: tuple[str, ...]
    lpips_digest: str
    lpips_views: int | None
    renderer: str
    pictures: tuple[int, ...] = ()
    hardest: int = 0

    @property
    def mask_digest(self) -> str:
        """Digest of which packets arrive; empty where nothing is sent."""
        return "" if self.mask is None else self.mask.digest

    @cached_property
    def key(self) -> str:
        """Name of the unit: equal for equal results. Paths do not count, contents do; nor do kept pictures."""
        content = {
            "code": CODE,
            "stream": self.stream.digest,
            "references": self.references.digest,
            "mask": self.mask_digest,
            "loss": self.loss and asdict(self.loss),
            **{name: getattr(self, name) for name in _COUNTING},
        }
        return hashlib.sha256(canonical(content).encode()).hexdigest()[:32]

    @property
    def concealer(self) -> str:
        """The concealer, with the path of its weights."""
        return self.conceal.replace(WEIGHTS, self.weights)

    def picture(self, view: int) -> str:
        """Path of a kept picture within the store."""
        return f"pictures/{self.key}_{view}.png"

    def loss_map(self, view: int) -> str:
        """Path of a loss map within the store: the same for all rows that meet the same losses."""
        digests = (self.stream.digest, self.references.digest, self.mask_digest)
        return f"pictures/map_{'_'.join(digest[:16] for digest in digests)}_{view}.png"

    def is_done(self, store: Store) -> bool:
        """Whether a store has its records and its pictures."""
        files = [self.picture(view) for view in self.pictures]
        if self.mask is not None and self.erode is None:
            files += [self.loss_map(view) for view in self.pictures[:1]]
        return store.has(self.key) and all((store.root / name).is_file() for name in files)


_COUNTING = (
    "scene", "seed", "conceal", "options", "file_digest", "erode", "metrics", "lpips_digest", "lpips_views", "renderer",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Cell:
    """A unit and the place of its result in the tables."""

    scene: str
    row: Row
    loss: Loss | None
    seed: int | None
    unit: Unit


def list_cells(study: Study, scenes: Mapping[str, PreparedScene], *, lpips_digest: str) -> list[Cell]:
    """Lists everything that an evaluation needs.

    Args:
        study: The evaluation.
        scenes: What was prepared, by name of the scene.
        lpips_digest: Digest of the LPIPS weights; empty if they are absent.
    """
    cells = []
    for scene in scenes.values():
        for row in study.rows:
            if scene.lacks(row):
                continue
            losses: list[tuple[Loss | None, int | None]] = [(None, None)]
            if not row.lossless and scene.streams[row.variant].num_packets:
                losses = [(loss, seed) for loss in study.losses for seed in study.seeds]
            cells += [_cell(study, scene, row, loss, seed, lpips_digest) for loss, seed in losses]
    return cells


def _cell(study: Study, scene: PreparedScene, row: Row, loss: Loss | None, seed: int | None, lpips_digest: str) -> Cell:
    weights = str(scene.entry.weights or "") if row.needs_weights else ""
    stream = scene.streams[row.variant]
    files = concealer_files(row.conceal.replace(WEIGHTS, weights), row.options)
    read = [digest_of_files(file) for file in files]
    unit = Unit(
        scene=scene.entry.name,
        label=row.label,
        stream=stream,
        references=scene.references,
        mask=None if loss is None or seed is None else scene.masks[(row.variant, loss, seed)],
        loss=loss,
        seed=seed,
        conceal=row.conceal,
        options=row.options,
        weights=weights,
        file_digest=" ".join([*read, *concealer_package(row.conceal)]),
        erode=row.erode,
        metrics=study.metrics,
        lpips_digest=lpips_digest if "lpips" in study.metrics else "",
        lpips_views=study.lpips_views,
        renderer=study.renderer,
    )
    return Cell(scene.entry.name, row, loss, seed, unit)
