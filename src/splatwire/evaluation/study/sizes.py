"""Comparison of file sizes with the official HAC++ code on the same elements, by attribute; nothing is rendered."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError
from splatwire.evaluation.study.definition import Row, SceneEntry, Study
from splatwire.evaluation.study.inputs import PreparedStream, Source, check_scenes, prepare_streams
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.tables import Table
from splatwire.io.importing import import_model
from splatwire.types import AnchorScene, Mlp

LOG = logging.getLogger(__name__)

NATIVE = "HAC++ files"
_BYTES_OF_FLOAT32 = 4
_GEOMETRY, _GRID, _ATTRIBUTES, _NETWORKS, _REST = (
    "positions and bounds",
    "hash grid",
    "attributes and masks",
    "networks",
    "headers and bookkeeping",
)
_OURS = {
    "side_positions": _GEOMETRY,
    "side_grid": _GRID,
    "side_prior_network": _NETWORKS,
    "side_channel_networks": _NETWORKS,
    "side_networks": _NETWORKS,
    "side_render_networks": _NETWORKS,
    "packet_payloads": _ATTRIBUTES,
    "side_masks": _ATTRIBUTES,
}
"""Category of each part of a stream of this package; packet headers and all other parts are overhead."""


@dataclass(frozen=True)
class SceneSizes:
    """Sizes of a scene as official HAC++ files and as splatwire streams with several packetizations, bytes.

    Bytes are divided into categories: positions, hash grid, attributes and masks, networks, and headers.

    Attributes:
        scene: Name of the scene.
        num_anchors: Number of elements, equal for all encodings.
        columns: Bytes of each category, for the official files (if present) and for every packetization.
        attribute_files: Bytes of features, scalings and offsets in each encoding.
        elements: Name of the elements, such as `anchors`.
    """

    # `attribute_files` is compared with published sizes. For this package, it counts whole packets, with headers and
    # offset masks; for the official code, only the files of these attributes.

    scene: str
    num_anchors: int
    columns: Mapping[str, Mapping[str, int]]
    attribute_files: Mapping[str, int]
    elements: str = AnchorScene.ELEMENTS

    def growth(self, column: str, categories: Sequence[str] | None = None) -> float | None:
        """Returns by how many percent an encoding of the scene is larger than the official HAC++ files.

        Args:
            column: Name of the encoding in `columns`.
            categories: Categories to count; None for all but the network weights.

        Returns:
            The excess in percent; None if the scene has no official files.
        """
        if NATIVE not in self.columns:
            return None
        wanted = categories or [part for part in _ORDER if part != _NETWORKS]
        ours, native = (sum(self.columns[c].get(part, 0) for part in wanted) for c in (column, NATIVE))
        return 100 * (ours / native - 1)

    def file_growth(self, column: str) -> float | None:
        """Returns by how many percent the attributes of an encoding are larger than those in the official HAC++ files.

        The attributes are features, scalings and offsets.

        Args:
            column: Name of the encoding in `columns`.

        Returns:
            The excess in percent; None if the scene has no official files.
        """
        if NATIVE not in self.attribute_files:
            return None
        return 100 * (self.attribute_files[column] / self.attribute_files[NATIVE] - 1)


_NATIVE_FILES = {
    "feat_": _ATTRIBUTES,
    "scaling_": _ATTRIBUTES,
    "offsets_": _ATTRIBUTES,
    "masks": _ATTRIBUTES,
    "hash": _GRID,
    "xyz_gpcc": _GEOMETRY,
    "x_bound_": _GEOMETRY,
}
"""Category of the official HAC++ files, by prefix of the file name."""
_ATTRIBUTE_FILES = ("feat_", "scaling_", "offsets_")
_PACKET_FILES = ("packet_headers", "packet_payloads")
_ORDER = (_GEOMETRY, _GRID, _ATTRIBUTES, _REST, _NETWORKS)


@checked
def measure_study_sizes(study: Study, store: Store, progress: Callable[[str, float], None]) -> list[SceneSizes]:
    """Encodes every scene with the packetization of every table row, and counts the bytes by category (`SceneSizes`).

    Args:
        study: Definition of a comparison of sizes.
        store: Store for encoded streams.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        SplatwireError: If a scene cannot be read or encoded.
    """
    with store.locked():
        check_scenes(study, store, views=False)
        scene_sizes = []
        for entry in study.scenes:
            streams = prepare_streams(study, Source(entry, store.files), store, progress)
            columns: dict[str, Mapping[str, int]] = {}
            files: dict[str, int] = {}
            if (native := native_parts(entry)) is not None:
                columns[NATIVE], files[NATIVE] = native, native_attribute_files(entry)
            for row in (row for row in study.rows if not row.decoded):
                if row.variant not in streams:
                    LOG.warning(
                        "scene '%s': row '%s' is left out: the scene cannot be packed so, or its sections are absent "
                        "or cannot be kept", entry.name, row.key,
                    )  # fmt: skip
                    continue
                columns[row.label] = our_parts(streams[row.variant])
                files[row.label] = sum(streams[row.variant].parts[part] for part in _PACKET_FILES)
            first = next(iter(streams.values()))
            scene_sizes.append(SceneSizes(entry.name, first.num_anchors, columns, files, first.elements))
        return scene_sizes


def our_parts(stream: PreparedStream) -> dict[str, int]:
    """Returns the numbers of bytes of a splatwire stream in each category of `SceneSizes`."""
    parts = dict.fromkeys(_ORDER, 0)
    for name, size in stream.parts.items():
        parts[_OURS.get(name, _REST)] += size
    return parts


def native_parts(entry: SceneEntry) -> dict[str, int] | None:
    """Returns the bytes of the official HAC++ files by category (`SceneSizes`), or None without such files."""
    # The official bitstream omits the networks although its decoder needs them. They are counted as float32, as in the
    # official total.
    folder = entry.source / "bitstreams"
    if entry.kind != "model" or not folder.is_dir():
        return None
    parts = dict.fromkeys(_ORDER, 0)
    for file in sorted(folder.iterdir()):
        parts[_native_part(file)] += file.stat().st_size
    parts[_NETWORKS] = _BYTES_OF_FLOAT32 * num_network_parameters(import_model("hacpp", entry.source))
    return parts


def native_attribute_files(entry: SceneEntry) -> int:
    """Returns the total size of the official HAC++ files with features, scalings and offsets, bytes."""
    files = (entry.source / "bitstreams").iterdir()
    return sum(file.stat().st_size for file in files if file.name.startswith(_ATTRIBUTE_FILES))


def _native_part(file: Path) -> str:
    for start, part in _NATIVE_FILES.items():
        if file.name.startswith(start):
            return part
    raise InvalidValueError(f"{file} is not a file of the official HAC++ code")


def num_network_parameters(scene: AnchorScene) -> int:
    """Number of weights and biases of all networks of a scene."""
    networks: list[Mlp] = [
        scene.heads.opacity,
        scene.heads.covariance,
        scene.heads.color,
        scene.hacpp.context_model.prior,
    ]
    layers = [
        layer
        for network in (*networks, *scene.hacpp.context_model.channel)
        for layer in (network.hidden, network.output)
    ]
    return sum(math.prod(layer.weight.shape) + math.prod(layer.bias.shape) for layer in layers)


def size_tables(study: Study, scene_sizes: Sequence[SceneSizes]) -> list[Table]:
    """Returns one table of sizes for each scene, and a table that compares the sizes with `Study.published`."""
    return [_scene_table(study, sizes) for sizes in scene_sizes] + _published_table(study, scene_sizes)


def _scene_table(study: Study, sizes: SceneSizes) -> Table:
    names = list(sizes.columns)
    absent = [row.label for row in study.rows if row.label not in names]
    title = f"{sizes.scene}: bytes of {sizes.num_anchors:,} {sizes.elements}"
    rows = [(part, *(f"{sizes.columns[name][part]:,}" for name in names)) for part in _ORDER[:-1]]
    weightless = {name: sum(sizes.columns[name][part] for part in _ORDER[:-1]) for name in names}
    total = {name: weightless[name] + sizes.columns[name][_NETWORKS] for name in names}
    rows.append(("sum, weights out", *(f"{weightless[name]:,}" for name in names)))
    rows.append((_NETWORKS, *(f"{sizes.columns[name][_NETWORKS]:,}" for name in names)))
    rows.append(("sum, weights in", *(f"{total[name]:,}" for name in names)))
    if NATIVE in sizes.columns:
        for label, sums in (("weights out, against HAC++", weightless), ("weights in, against HAC++", total)):
            rows.append((label, *(f"{100 * (sums[name] / sums[NATIVE] - 1):+.2f} %" for name in names)))
        for label, growth in _ATTRIBUTE_MEASURES:
            rows.append((f"{label}, against HAC++", *(_percent(growth(sizes, name)) for name in names)))
    title += f" (not for this scene: {', '.join(absent)})" if absent else ""
    return Table(title, ("part", *names), tuple(rows))


_ATTRIBUTE_MEASURES: tuple[tuple[str, Callable[[SceneSizes, str], float | None]], ...] = (
    ("files with attributes", SceneSizes.file_growth),
    ("attributes and masks alone", lambda sizes, column: sizes.growth(column, (_ATTRIBUTES,))),
)
"""Two ways to count attribute bytes; the first is used in the publication of HAC++."""


def _percent(value: float | None) -> str:
    return "no native files" if value is None else f"{value:+.2f} %"


def _published_table(study: Study, scene_sizes: Sequence[SceneSizes]) -> list[Table]:
    lines = []
    for entry in study.published:
        row: Row = study.row(entry.row)
        published = f"({entry.dataset})"
        if "growth_percent" in entry.values:
            cells = [_percent(sizes.growth(row.label)) for sizes in scene_sizes]
            published_growth = f"{entry.values['growth_percent']:+.2f} % {published}"
            lines.append((f"{row.label}: everything but weights", published_growth, *cells))
        if "attribute_growth_percent" in entry.values:
            theirs = (f"{entry.values['attribute_growth_percent']:+.2f} % {published}", "")
            for (label, growth), published_growth in zip(_ATTRIBUTE_MEASURES, theirs, strict=True):
                cells = [_percent(growth(sizes, row.label)) for sizes in scene_sizes]
                lines.append((f"{row.label}: {label}", published_growth, *cells))
    columns = ("growth over HAC++ files", "paper", *(sizes.scene for sizes in scene_sizes))
    return [Table("Growth of the bitstream", columns, tuple(lines))] if lines else []
