"""Tasks of an evaluation: one method under one loss mask, identified by a digest of all inputs."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from splatwire.channel import PacketLossMask
from splatwire.concealment.registry import concealer_files, concealer_package
from splatwire.evaluation.study.definition import WEIGHTS, Loss, Row, Study, canonical
from splatwire.evaluation.study.inputs import PreparedScene, PreparedStream
from splatwire.evaluation.study.records import CODE
from splatwire.evaluation.study.references import References, digest_of_files
from splatwire.evaluation.study.store import Store
from splatwire.metrics.registry import LPIPS_SCALED, METRICS


@dataclass(frozen=True, eq=False)
class Unit:
    """A task of an evaluation: one method on one scene under one loss mask.

    Attributes:
        scene: Name of the scene.
        label: Label of the method.
        stream: The stream that is sent, or the scene file that is evaluated without transmission.
        references: The reference images.
        mask: Loss mask; None if nothing is sent.
        loss: The loss model; None without loss.
        seed: Seed of the mask; None without loss.
        conceal: Name of the concealer.
        options: Options of the concealer.
        weights: File of the scene's GNN weights; empty if unused.
        file_digest: Text that identifies further inputs of the task: digests of weight files, and versions of other
            packages. Empty if the result depends on neither.
        erode: The one attribute that is removed from anchors in lost packets; None if all attributes are removed.
        metrics: Names of the metrics.
        lpips_digest: Digest of the LPIPS weights; empty if they are absent or LPIPS is not requested.
        lpips_views: Maximum number of views for LPIPS.
        renderer: Name of the renderer.
        pictures: Indices of the views whose images are stored.
        hardest: If `pictures` is empty, the number of views whose images are stored. These are the views with the
            lowest PSNR.
    """

    scene: str
    label: str
    stream: PreparedStream
    references: References
    mask: PacketLossMask | None
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
        """Hash of the loss mask; empty if nothing is sent."""
        return "" if self.mask is None else self.mask.digest

    @cached_property
    def key(self) -> str:
        """Hash of all inputs that affect the scores of the task. The results of the task are stored under this hash."""
        # Files count by their contents, not by their paths. The selection of images to store does not count.
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
        """Specification of the concealer: its name and, if needed, the path of its weights."""
        return self.conceal.replace(WEIGHTS, self.weights)

    def picture(self, view: int) -> str:
        """Returns the path of a stored image within the store."""
        return f"pictures/{self.key}_{view}.png"

    def loss_map(self, view: int) -> str:
        """Returns the path, within the store, of the image that shows received and lost elements in a view.

        Args:
            view: Index of the view.
        """
        digests = (self.stream.digest, self.references.digest, self.mask_digest)
        version = CODE.replace("/", "-")
        return f"pictures/map_{version}_{'_'.join(digest[:16] for digest in digests)}_{view}.png"

    def is_done(self, store: Store) -> bool:
        """Returns True if the store contains the records and images of the task."""
        files = [self.picture(view) for view in self.pictures]
        if self.mask is not None and self.erode is None and not self.references.frames:
            files += [self.loss_map(view) for view in self.pictures[:1]]
        return store.has(self.key) and all((store.root / name).is_file() for name in files)


_COUNTING = (
    "scene", "seed", "conceal", "options", "file_digest", "erode", "metrics", "lpips_digest", "lpips_views", "renderer",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Cell:
    """A task of an evaluation, with the position of its result in the tables.

    Attributes:
        scene: Name of the scene.
        row: Table row (method).
        loss: The loss; None for a row without loss.
        seed: Seed of the loss; None for a row without loss.
        unit: The task.
    """

    scene: str
    row: Row
    loss: Loss | None
    seed: int | None
    unit: Unit


def list_cells(study: Study, scenes: Mapping[str, PreparedScene], *, lpips_digest: str) -> list[Cell]:
    """Lists all combinations of scene, method, loss model and seed of an evaluation, with their tasks.

    Args:
        study: The evaluation.
        scenes: Prepared scenes by name.
        lpips_digest: Hash of the LPIPS weights; empty if they are absent.
    """
    cells = []
    for scene in scenes.values():
        for row in study.rows:
            if scene.why_unsupported(row):
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
    packages = [package for metric in study.metrics for package in METRICS.packages(metric)]
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
        file_digest=" ".join([*read, *concealer_package(row.conceal), *packages]),
        erode=row.erode,
        metrics=study.metrics,
        lpips_digest="" if LPIPS_SCALED.keys().isdisjoint(study.metrics) else lpips_digest,
        lpips_views=study.lpips_views,
        renderer=study.renderer,
    )
    return Cell(scene.entry.name, row, loss, seed, unit)
