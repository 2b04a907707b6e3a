"""Definition of an evaluation: scenes, methods (table rows), loss models and seeds, as frozen data."""

import dataclasses
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatwire.arguments import CheckedFields, check_fields
from splatwire.bitstream import PRESETS, SEND_ORDERS, Packetization
from splatwire.channel import LossModel, parse_loss
from splatwire.channel.loss_models import UNIT_NAMES
from splatwire.concealment import create_concealer
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.data.dataset import SPLITS, TEST_VIEWS
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.evaluation.study.records import RECORD_COLUMNS
from splatwire.metrics.registry import METRICS
from splatwire.render import create_renderer
from splatwire.types.background import Background, check_background

MAX_SEEDS = 1000
DEFAULT_METRICS = ("psnr", "ssim", "lpips")
SIZE_METRICS = ("growth_percent", "attribute_growth_percent")
"""Published size metrics: relative growth of the stream without network weights, and of the attribute data only."""
ERODIBLE = ("feature", "scaling", "offset", "mask")
KINDS = ("losses", "sizes")
SOURCES = ("stream", "scene", "model")
"""Values of `SceneEntry.kind`."""
PASSTHROUGH = "stream"
"""Name of the stream variant of table rows (methods) that send a stream, or score a scene, without repacking."""
WEIGHTS = "{weights}"
"""Placeholder `gnn:{weights}` in a concealer's name, replaced by the path of the scene's own GNN weights."""


@dataclass(frozen=True)
class SceneEntry:
    """One scene of an evaluation, with the views and the reference images with which its renders are compared.

    Attributes:
        name: Name of the scene in reports.
        source: File or folder with the scene, of the given `kind`.
        kind: `stream` for a stream, `scene` for a scene file, `model` for a folder of the official HAC++ code.
        photos: Folder of the dataset that defines the views. Its photos are the reference images, unless `reference` is
            given. None for rendered reference images.
        cameras: Cameras file that defines the views; ignored if `photos` is given. If both are None, views around the
            scene are generated.
        reference: Scene or frames whose renders are the reference images, even if `photos` is given. If this is None,
            the photos are the reference images. If `photos` is None, too, renders of the scene itself are used.
        dataset: Name of the group of scenes over which results are averaged.
        images: Folder of photos to read instead of the folder `images` of the dataset, such as `images_4`; None to read
            the photos that the dataset names.
        split: Split of the dataset to read: `train`, `test` or `all`.
        test_views: Rule that selects the test views of the dataset; None for the default rule of its layout.
        max_width: Maximum width of photos, pixels. Wider photos are reduced to this width.
        weights: Network weights for methods that conceal losses with a GNN, calibrated for this scene; None if there
            are none.
        sections: Stream of the scene with additional sections of side information, which some methods need. It is
            evaluated instead of `source`. None to use `source`.
        background: RGB of the background; None for the background with which the scene was trained.
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
        check_fields(self)
        _known("kind of scene", self.kind, SOURCES)
        if self.background is not None:
            check_background(self.background)
        _known("split", self.split, SPLITS)
        if self.test_views is not None:
            _known("choice of test views", self.test_views, TEST_VIEWS)


@dataclass(frozen=True)
class Decoded:
    """Result of another codec on one scene.

    Attributes:
        scene: Name of the scene.
        source: File of the decoded scene, or folder with one picture per view, rendered from the decoded scene.
        num_bytes: Number of bytes that the codec sends; None for the size of `source`.
    """

    scene: str
    source: Path
    num_bytes: int | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.num_bytes is not None and self.num_bytes < 1:
            raise InvalidValueError(f"num_bytes must be at least 1, not {self.num_bytes}")


@dataclass(frozen=True)
class Row:
    """Row of the result table of an evaluation: a method with packetization and concealment.

    Attributes:
        key: Identifier of the row within the evaluation, for example to name the baseline.
        label: Display name in tables.
        packetization: Packetization of the stream; None to use the scene's stream or file without repacking.
        conceal: Name of the concealer.
        options: Options of the concealer.
        erode: For an ablation: the attribute that anchors in lost packets lose, while they keep all others. None if
            they lose all attributes.
        lossless: True if the row is evaluated without packet losses.
        sections: Names of the sections of side information that the method needs. Repacking removes the other sections,
            apart from background and masks.
        decoded: Results of another codec, one per scene; empty for a stream that is encoded here.
        curve: Name of the rate-distortion curve with this row as a point; empty for none.
    """

    key: str
    label: str
    packetization: Packetization | None
    conceal: str = "drop"
    options: Mapping[str, Any] = field(default_factory=dict)
    erode: str | None = None
    lossless: bool = False
    sections: tuple[str, ...] = ()
    decoded: tuple[Decoded, ...] = ()
    curve: str = ""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.decoded:
            _unique("result of a scene", [decoded.scene for decoded in self.decoded], least=1)
            if not self.lossless or self.erode is not None or self.sections:
                raise InvalidValueError(f"row '{self.key}': nothing is lost of results of another codec")
        if self.erode is not None:
            _known("attribute", self.erode, ERODIBLE)
            if self.packetization is None or self.packetization.packaging != "atomic":
                raise InvalidValueError(f"row '{self.key}': attribute erosion starts from atomic packets")
        if not self.needs_weights:
            _check_concealer(self.conceal, self.options)

    @property
    def needs_weights(self) -> bool:
        """True if the concealer uses GNN weights of the scene."""
        return WEIGHTS in self.conceal

    @property
    def variant(self) -> str:
        """Name of the stream that this method uses, also for file names.

        The name consists of the packetization and the additional side information. Methods with equal names use the
        same stream.
        """
        if self.decoded:
            return f"decoded-{self.key}"
        if self.packetization is None:
            return PASSTHROUGH
        packetization = self.packetization
        name = min((_difference(preset, packetization, name) for name, preset in PRESETS.items()), key=len)
        return "+".join(["-".join(name), *sorted(self.sections)])


@dataclass(frozen=True)
class Loss:
    """Model of the packets or datagrams that a channel loses.

    Attributes:
        model: Specification for `splatwire.channel.loss_text`.
        unit: `pak`: whole packets are lost. `datagram`: datagrams of 1200 bytes are lost, and a packet is lost if any
            of its datagrams is lost.
        send_order: Order in which packets are sent, one of `splatwire.bitstream.SEND_ORDERS`.
    """

    model: str
    unit: str = "pak"
    send_order: str = "interleaved"

    def __post_init__(self) -> None:
        check_fields(self)
        parse_loss(self.model, self.unit)
        _known("send order", self.send_order, SEND_ORDERS)

    @property
    def process(self) -> LossModel:
        """The loss model, created from its specification."""
        return parse_loss(self.model, self.unit)

    @property
    def label(self) -> str:
        """One-line description of the loss model for reports, such as `bernoulli:0.1 per packet`."""
        if self.model == "none":
            return "no loss"
        order = "" if self.send_order == "interleaved" else f", {self.send_order} order"
        return f"{self.model} per {UNIT_NAMES[self.unit]}{order}"


@dataclass(frozen=True)
class Published(CheckedFields):
    """Published results of one method on a group of scenes, for comparison.

    Attributes:
        row: Key of the table row that evaluates the same method.
        dataset: Name of the group of scenes in the publication.
        values: Published value of each metric, by name.
    """

    row: str
    dataset: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class Study:
    """A complete evaluation, as defined by a protocol file.

    Attributes:
        name: Name of the table, usable in file names.
        title: Headline.
        scenes: The scenes.
        rows: Rows of the result table (methods), in order.
        losses: Loss models.
        seeds: Seeds; one transmission per seed.
        kind: `losses` for image quality under packet losses, `sizes` for a comparison of bytes only.
        notes: Paragraphs for the report.
        baseline: Key of the row with which the other rows are compared under the same losses.
        published: Published results for comparison.
        metrics: Names of the metrics.
        views: Maximum number of views per scene, evenly spaced; None for all.
        lpips_views: Maximum number of views for LPIPS; None for all.
        renderer: Name of the renderer.
        picture_views: Number of views per scene that the report shows: the views with the lowest PSNR.
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
    metrics: tuple[str, ...] = DEFAULT_METRICS
    views: int | None = None
    lpips_views: int | None = None
    renderer: str = "cpu"
    picture_views: int = 2

    def __post_init__(self) -> None:
        check_fields(self)
        _known("kind of protocol", self.kind, KINDS)
        _unique("scene", [scene.name for scene in self.scenes], least=1)
        _unique("row", [row.key for row in self.rows], least=1)
        _unique("row label", [row.label for row in self.rows], least=1)
        settings = [(row.key, _settings(row)) for row in self.rows]
        for (one, of_one), (two, of_two) in itertools.combinations(settings, 2):
            if of_one == of_two:
                raise InvalidValueError(f"rows '{one}' and '{two}' have the same settings: keep one of them")
        _unique("loss", [loss.label for loss in self.losses], least=0 if self.kind == "sizes" else 1)
        _unique("seed", [str(seed) for seed in self.seeds], least=1)
        if min(self.seeds) < 0 or len(self.seeds) > MAX_SEEDS:
            raise InvalidValueError(f"seeds must be 1 to {MAX_SEEDS} numbers from 0, not {list(self.seeds)}")
        _unique("metric", list(self.metrics), least=1)
        for metric in self.metrics:
            _check_metric(metric)
        counts = {
            "views": (self.views, 1),
            "lpips_views": (self.lpips_views, 1),
            "picture_views": (self.picture_views, 0),
        }
        for name, (count, least) in counts.items():
            if count is not None and count < least:
                raise InvalidValueError(f"{name} must be at least {least}, not {count}")
        create_renderer(self.renderer)
        self._check_references()

    def _check_references(self) -> None:
        keys, scenes = [row.key for row in self.rows], [scene.name for scene in self.scenes]
        for decoded in (decoded for row in self.rows for decoded in row.decoded):
            _known("scene", decoded.scene, scenes)
        for key in [*(entry.row for entry in self.published), *([self.baseline] if self.baseline else [])]:
            _known("row", key, keys)
        _unique("published figure", [f"{p.row} / {p.dataset}" for p in self.published], least=0)
        for entry in self.published:
            for metric in entry.values:
                if metric not in SIZE_METRICS:
                    _check_metric(metric)

    @property
    def lossy_rows(self) -> tuple[Row, ...]:
        """Rows of the result table that are evaluated with packet losses."""
        return tuple(row for row in self.rows if not row.lossless)

    def row(self, key: str) -> Row:
        """Returns the method (row of the result table) with the given key."""
        return next(row for row in self.rows if row.key == key)


def _difference(preset: Packetization, other: Packetization, name: str) -> list[str]:
    """Describes a packetization as a preset and the parameters whose values differ from those of the preset.

    Args:
        preset: The preset.
        other: The packetization.
        name: Name of the preset.
    """
    changed = {key: value for key, value in vars(other).items() if getattr(preset, key) != value}
    return [name, *(value if isinstance(value, str) else f"{key}={value}" for key, value in changed.items())]


def canonical(content: Mapping[str, Any]) -> str:
    """Serialises to JSON in canonical form, so that equal content gives equal text."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _settings(row: Row) -> str:
    """Returns the settings of a method that affect its results, as JSON text."""
    settings = dataclasses.asdict(dataclasses.replace(row, key="", label="", decoded=(), curve=""))
    return canonical(settings | {"decoded": [str(decoded) for decoded in row.decoded]})


def _check_concealer(name: str, options: Mapping[str, Any]) -> None:
    """Checks that a concealer exists, for static scenes or sequences, and accepts the options.

    Raises:
        UnknownNameError: If no concealer has that name.
        InvalidValueError: If it does not accept the options.
    """
    try:
        create_concealer(name, **options)
    except UnknownNameError as error:
        try:
            temporal_concealer(name, **options)
        except UnknownNameError:
            raise error from None


def _check_metric(name: str) -> None:
    """Checks that a metric exists, and that no column of the result records has the same name.

    Raises:
        UnknownNameError: If no metric has that name.
        InvalidValueError: If a column of the result records has the name.
    """
    if name in RECORD_COLUMNS:
        raise InvalidValueError(f"metric '{name}' has the name of a column of records: rename it")
    if name not in DEFAULT_METRICS:
        METRICS[name]


def _known(kind: str, name: str, allowed: Sequence[str]) -> None:
    if name not in allowed:
        raise UnknownNameError(kind, name, allowed)


def _unique(subject: str, names: Sequence[str], *, least: int) -> None:
    if len(names) < least:
        raise InvalidValueError(f"there must be at least {least} {subject}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidValueError(f"{subject} {repeated[0]} is there {names.count(repeated[0])} times: once is right")


def common_word(words: Iterable[str]) -> str:
    """Returns the name that reports use for the elements of all scenes, such as `anchors`.

    Args:
        words: Name of the elements of each scene; if these differ, the result is `elements`.
    """
    different = set(words)
    return different.pop() if len(different) == 1 else "elements"
