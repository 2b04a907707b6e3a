"""What is evaluated: scenes, rows, losses and seeds, as plain frozen data."""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatwire.channel import LossModel, parse_loss
from splatwire.conceal import create_concealer
from splatwire.data.dataset import SPLITS, TEST_VIEWS
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.packets import PRESETS, SEND_ORDERS, Packetization
from splatwire.render import create_renderer
from splatwire.scene.background import Background

MAX_SEEDS = 1000
METRICS = ("psnr", "ssim", "lpips")
SIZE_METRICS = ("growth_percent", "attribute_growth_percent")
"""What a publication says about sizes: growth of everything but network weights, and of the attributes alone."""
ERODIBLE = ("feature", "scaling", "offset", "mask")
KINDS = ("losses", "sizes")
AS_IT_IS = "stream"
"""Variant of rows that send a stream, or score a scene, as it is."""
WEIGHTS = "{weights}"
"""Stands for the scene's own GNN weights in the concealer of a row: `gnn:{weights}`."""


@dataclass(frozen=True)
class SceneEntry:
    """One scene and the views it is judged on.

    Attributes:
        name: What it is called.
        source: A stream, a scene file, or a folder of the official HAC++ code (`kind` says which).
        kind: `stream`, `scene` or `model`.
        photos: Dataset folder whose test photos are the references; None to compare with renders.
        cameras: Cameras file for renders; None to take the views of `photos`, or views around the scene.
        reference: What is drawn from those views as references: a scene file, a stream or explicit Gaussians; None for
            the photos, or the scene itself where there are none.
        dataset: The group of scenes over which results are averaged.
        images: Image folder within the dataset.
        split: As in `splatwire.data.open_dataset`.
        test_views: The same.
        max_width: The same.
        weights: Calibrated weights of the GNN for this scene.
        sections: A stream of this scene whose named sections rows may ask for; None to take them from `source`, if that
            is a stream.
        background: RGB behind everything; None for what the scene was trained in front of.
    """

    name: str
    source: Path
    kind: str
    photos: Path | None = None
    cameras: Path | None = None
    reference: Path | None = None
    dataset: str = ""
    images: str | None = None
    split: str = "test"
    test_views: str | None = None
    max_width: int = 1600
    weights: Path | None = None
    sections: Path | None = None
    background: Background | None = None

    def __post_init__(self) -> None:
        _known("split", self.split, SPLITS)
        if self.test_views is not None:
            _known("choice of test views", self.test_views, TEST_VIEWS)


@dataclass(frozen=True)
class Row:
    """One row of a table.

    Attributes:
        key: Short name that published figures and the baseline refer to.
        label: What the table shows.
        packetization: How the scene is packed; None to send a stream, or to score a scene, as it is.
        conceal: Name of the concealer.
        options: Options of the concealer.
        erode: The one attribute that the lost anchors lose, everything else of them being kept; None for real losses.
        lossless: Whether the row is spared from losses.
        sections: Named sections of the side information that the row's stream carries; their bytes count.
    """

    key: str
    label: str
    packetization: Packetization | None
    conceal: str = "drop"
    options: Mapping[str, Any] = field(default_factory=dict)
    erode: str | None = None
    lossless: bool = False
    sections: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.erode is not None:
            _known("attribute", self.erode, ERODIBLE)
            if self.packetization is None or self.packetization.packaging != "atomic":
                raise InvalidValueError(f"row '{self.key}': attribute erosion starts from atomic packets")
        if not self.needs_weights:
            create_concealer(self.conceal, **self.options)

    @property
    def needs_weights(self) -> bool:
        """Whether the concealer takes the weights of the scene."""
        return WEIGHTS in self.conceal

    @property
    def variant(self) -> str:
        """Short name of the stream that the row needs, good for file names."""
        if self.packetization is None:
            return AS_IT_IS
        packetization = self.packetization
        name = min((_difference(preset, packetization, name) for name, preset in PRESETS.items()), key=len)
        return "+".join(["-".join(name), *sorted(self.sections)])


@dataclass(frozen=True)
class Loss:
    """What the channel does.

    Attributes:
        model: As `splatwire.channel.loss_text` reads it.
        unit: `pak`: whole packets are lost; `datagram`: the model loses datagrams of 1200 bytes, and a packet is lost
            with the first of its datagrams.
        send_order: As in `splatwire.channel.transmit`.
    """

    model: str
    unit: str = "pak"
    send_order: str = "interleaved"

    def __post_init__(self) -> None:
        parse_loss(self.model, self.unit)
        _known("send order", self.send_order, SEND_ORDERS)

    @property
    def process(self) -> LossModel:
        """The model, which knows what it loses."""
        return parse_loss(self.model, self.unit)

    @property
    def label(self) -> str:
        """The loss in one line."""
        order = "" if self.send_order == "interleaved" else f", {self.send_order} order"
        return f"{self.model} per {self.unit}{order}"


@dataclass(frozen=True)
class Published:
    """What a publication prints for one row.

    Attributes:
        row: Key of the row.
        dataset: The publication's name of the group of scenes.
        values: Figure by metric.
    """

    row: str
    dataset: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class Study:
    """A whole evaluation, such as a protocol file describes it.

    Attributes:
        name: Name of the table, good for file names.
        title: Headline.
        scenes: The scenes.
        rows: The rows of the table, in order.
        losses: What the channel does, one after another.
        seeds: One transmission per seed.
        kind: `losses`, or `sizes` for a comparison of bytes alone.
        notes: Paragraphs for the report.
        baseline: Key of the row that others are compared with, mask by mask.
        published: Printed figures.
        metrics: What is measured.
        views: Most views per scene, spread evenly; None for all.
        lpips_views: Most views that LPIPS is computed on; None for all.
        renderer: Name of the renderer.
        picture_views: Views per scene that the report shows, hardest first.
    """

    name: str
    title: str
    scenes: tuple[SceneEntry, ...]
    rows: tuple[Row, ...]
    losses: tuple[Loss, ...] = ()
    seeds: tuple[int, ...] = (0,)
    kind: str = "losses"
    notes: tuple[str, ...] = ()
    baseline: str | None = None
    published: tuple[Published, ...] = field(default=())
    metrics: tuple[str, ...] = METRICS
    views: int | None = None
    lpips_views: int | None = None
    renderer: str = "cpu"
    picture_views: int = 2

    def __post_init__(self) -> None:
        _known("kind of protocol", self.kind, KINDS)
        _unique("scene", [scene.name for scene in self.scenes], least=1)
        _unique("row", [row.key for row in self.rows], least=1)
        _unique("row label", [row.label for row in self.rows], least=1)
        _unique("setting of a row", [_settings(row) for row in self.rows], least=1)
        _unique("loss", [loss.label for loss in self.losses], least=0 if self.kind == "sizes" else 1)
        _unique("seed", [str(seed) for seed in self.seeds], least=1)
        if min(self.seeds) < 0 or len(self.seeds) > MAX_SEEDS:
            raise InvalidValueError(f"seeds must be 1 to {MAX_SEEDS} numbers from 0, not {list(self.seeds)}")
        _unique("metric", list(self.metrics), least=1)
        for metric in self.metrics:
            _known("metric", metric, METRICS)
        counts = {
            "views": (self.views, 1),
            "lpips_views": (self.lpips_views, 1),
            "picture_views": (self.picture_views, 0),
        }
        for what, (count, least) in counts.items():
            if count is not None and count < least:
                raise InvalidValueError(f"{what} must be at least {least}, not {count}")
        create_renderer(self.renderer)
        self._check_references()

    def _check_references(self) -> None:
        keys = [row.key for row in self.rows]
        for key in [*(entry.row for entry in self.published), *([self.baseline] if self.baseline else [])]:
            _known("row", key, keys)
        _unique("published figure", [f"{p.row} / {p.dataset}" for p in self.published], least=0)
        for entry in self.published:
            for metric in entry.values:
                _known("metric", metric, METRICS + SIZE_METRICS)

    @property
    def lossy_rows(self) -> tuple[Row, ...]:
        """The rows that meet losses."""
        return tuple(row for row in self.rows if not row.lossless)

    def row(self, key: str) -> Row:
        """The row of a key."""
        return next(row for row in self.rows if row.key == key)


def _difference(preset: Packetization, other: Packetization, name: str) -> list[str]:
    """The name of a preset, and what must be changed in it to have another packetization."""
    changed = {key: value for key, value in vars(other).items() if getattr(preset, key) != value}
    return [name, *(value if isinstance(value, str) else f"{key}={value}" for key, value in changed.items())]


def canonical(content: Mapping[str, Any]) -> str:
    """JSON text that is the same for the same content."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _settings(row: Row) -> str:
    """Everything of a row that changes a result."""
    return canonical(dataclasses.asdict(dataclasses.replace(row, key="", label="")))


def _known(kind: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise UnknownNameError(kind, name, known)


def _unique(what: str, names: Sequence[str], *, least: int) -> None:
    if len(names) < least:
        raise InvalidValueError(f"there must be at least {least} {what}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidValueError(f"{what} {repeated[0]} is there {names.count(repeated[0])} times: once is right")


def common_word(words: Iterable[str]) -> str:
    """What the elements of several scenes are called: their word, if they share one."""
    different = set(words)
    return different.pop() if len(different) == 1 else "elements"
