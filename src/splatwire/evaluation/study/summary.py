"""Statistics for result tables: means, confidence intervals, paired differences, bytes."""

import itertools
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.special import stdtrit

from splatwire.arguments import checked
from splatwire.evaluation.study.definition import Loss, Row, common_word
from splatwire.evaluation.study.records import Record
from splatwire.evaluation.study.run import StudyResult

CONFIDENCE = 0.95
INTERVALS = (
    "Figures are means over views, then over seeds. The interval after ± is the half width of the 95 % confidence "
    "interval of that mean: Student's t over the seeds, each seed one draw of losses on the same views. Differences "
    "are paired: seed by seed on the same mask where two rows share a stream, and on the same seed otherwise."
)


@dataclass(frozen=True)
class Estimate:
    """Mean over seeds of a measured value, with its uncertainty.

    Attributes:
        mean: Mean over seeds.
        spread: Standard deviation over seeds; None for one seed.
        half_width: Half width of the 95 % confidence interval of the mean (Student's t); None for one seed.
    """

    mean: float
    spread: float | None
    half_width: float | None

    @staticmethod
    def of(values: Sequence[float]) -> "Estimate | None":
        """Computes mean, standard deviation and confidence interval; None if a value is not finite or none is given."""
        if not values or not all(map(math.isfinite, values)):
            return None
        if len(values) == 1:
            return Estimate(values[0], None, None)
        spread = statistics.stdev(values)
        # Student's t; importing scipy.stats instead would take a second.
        quantile = float(stdtrit(len(values) - 1, (1 + CONFIDENCE) / 2))
        return Estimate(statistics.fmean(values), spread, quantile * spread / math.sqrt(len(values)))


@dataclass(frozen=True)
class Summary:
    """Statistics of one table row: one method on a scene, or on average over scenes, under one loss model.

    Attributes:
        scene: Name of the scene, or description of the mean over scenes.
        dataset: Group of scenes.
        row: The table row (method).
        loss: The loss; None for a row without loss.
        figures: Estimate of each metric, by name; None if a value is not finite.
        exact: True if every image equals its reference.
        delta: Estimate of the paired difference to the baseline, by metric; empty for the baseline itself.
        by_seed: For each metric by name, one value per seed: the mean over views.
        by_view: For each metric by name, one value per view: the mean over seeds.
        view_range: For each metric by name, two tuples with one value per view: the lowest value over all seeds, and
            the highest value over all seeds.
        num_bytes: Total size of the stream and of the network weights file that the concealer needs (if any), bytes.
        parts: Bytes of each part of the stream.
        num_packets: Number of packets of the stream.
        elements: Name of the scene's elements.
        num_anchors: Number of elements.
        num_gaussians: Number of Gaussians; None if unknown, as for pictures of another codec.
        lost_packets: Share of lost packets, mean over seeds.
        lost_anchors: Share of elements with a lost attribute, mean over seeds.
        lost_datagrams: Share of lost datagrams, mean over seeds; None without loss.
        seconds: Time of each processing step in seconds, mean over seeds, all views together.
        references: Kind of references, `photos`, `reference scenes` or `renders` of the scene itself.
    """

    scene: str
    dataset: str
    row: Row
    loss: Loss | None
    figures: Mapping[str, Estimate | None]
    exact: bool
    delta: Mapping[str, Estimate | None]
    by_seed: Mapping[str, tuple[float, ...]]
    by_view: Mapping[str, tuple[float, ...]]
    view_range: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]
    num_bytes: int
    parts: Mapping[str, int]
    num_packets: int
    elements: str
    num_anchors: int
    num_gaussians: int | None
    lost_packets: float
    lost_anchors: float
    lost_datagrams: float | None
    seconds: Mapping[str, float]
    references: str

    def to_json(self) -> dict[str, Any]:
        """Converts the statistics to JSON values."""
        content = asdict(self)
        content["row"], content["label"] = self.row.key, self.row.label
        content["loss"] = None if self.loss is None else self.loss.label
        return content


@checked
def summarize(result: StudyResult) -> list[Summary]:
    """Computes the statistics of every scene, method and loss model, in the order of the evaluation's definition."""
    groups: dict[tuple[str, str, Loss | None], list[list[Record]]] = {}
    for cell in result.cells:
        groups.setdefault((cell.scene, cell.row.key, cell.loss), []).append(result.records[cell.unit.key])
    summaries = []
    for (scene, key, loss), runs in groups.items():
        baseline = groups.get((scene, result.study.baseline or "", loss))
        base = None if baseline is None or key == result.study.baseline else baseline
        summaries.append(_summary(result, scene, result.study.row(key), loss, runs, base))
    return summaries


def _summary(
    result: StudyResult, scene: str, row: Row, loss: Loss | None, runs: list[list[Record]],
    baseline: list[list[Record]] | None,
) -> Summary:  # fmt: skip
    prepared = result.scenes[scene]
    stream, parts = prepared.streams[row.variant], prepared.parts[row.key]
    metrics = [m for m in result.study.metrics if any(record.figure(m) is not None for record in runs[0])]
    by_seed = {metric: tuple(_over_views(run, metric) for run in runs) for metric in metrics}
    views = {metric: _values_by_view(runs, metric) for metric in metrics}
    delta: dict[str, Estimate | None] = {}
    if baseline is not None and len(baseline) == len(runs):
        base = {metric: [_over_views(run, metric) for run in baseline] for metric in metrics}
        delta = {m: Estimate.of([a - b for a, b in zip(by_seed[m], base[m], strict=True)]) for m in metrics}
    encoded = {} if stream.seconds_encode is None else {"encode": stream.seconds_encode}
    return Summary(
        scene=scene,
        dataset=prepared.entry.dataset,
        row=row,
        loss=loss,
        figures={metric: Estimate.of(values) for metric, values in by_seed.items()},
        exact=all(record.psnr == math.inf for run in runs for record in run),
        delta=delta,
        by_seed=by_seed,
        by_view={metric: tuple(map(statistics.fmean, columns)) for metric, columns in views.items()},
        view_range={metric: _ends(columns) for metric, columns in views.items()},
        num_bytes=sum(parts.values()),
        parts=parts,
        num_packets=stream.num_packets,
        elements=stream.elements,
        num_anchors=stream.num_anchors,
        num_gaussians=stream.num_gaussians,
        lost_packets=_share(runs, "num_lost_packets", "num_packets") or 0.0,
        lost_anchors=_share(runs, "num_lost_anchors", "num_anchors") or 0.0,
        lost_datagrams=_share(runs, "num_lost_datagrams", "num_datagrams"),
        seconds=encoded | _seconds(runs),
        references=prepared.references.kind,
    )


def dataset_means(result: StudyResult, summaries: Sequence[Summary]) -> list[Summary]:
    """Computes the mean results of each dataset with several scenes; all scenes of a dataset have equal weight.

    Scenes with photos, with reference scenes and with their own renders as references have separate means.
    """
    # A comparison with photos also measures the model's own error, and one with a reference scene that of the encoding.
    # One with renders of the scene itself measures only the effect of losses.
    means = []
    for name in dict.fromkeys(s.dataset for s in summaries):
        own = [s for s in summaries if s.dataset == name]
        kinds = list(dict.fromkeys(s.references for s in own))
        for kind in kinds:
            same = [s for s in own if s.references == kind]
            against = f" against {kind}" if len(kinds) > 1 else ""
            means += _means(same, f"{f' of {name}' if name else ''}{against}", result.study.baseline)
    return means


def _means(summaries: Sequence[Summary], description: str, baseline: str | None) -> list[Summary]:
    """Averages the results of each method and loss model over all scenes; methods that lack a scene are omitted.

    Args:
        summaries: Statistics per scene and method.
        description: Description of the scenes, used as the scene name in the result.
        baseline: Key of the table row of the baseline; None without a baseline.

    Returns:
        One mean for each method and loss model; empty for a single scene.
    """
    # Methods that were not evaluated on every scene are left out.
    scenes = {s.scene for s in summaries}
    means = []
    for key, loss in dict.fromkeys((s.row.key, s.loss) for s in summaries) if len(scenes) > 1 else ():
        group = [s for s in summaries if (s.row.key, s.loss) == (key, loss)]
        if len(group) == len(scenes):
            means.append(_mean_of(group, description, summaries, baseline))
    return means


def _mean_of(group: Sequence[Summary], description: str, summaries: Sequence[Summary], baseline: str | None) -> Summary:
    first = group[0]
    by_seed = {metric: _mean_columns([s.by_seed[metric] for s in group]) for metric in first.by_seed}
    delta: dict[str, Estimate | None] = {}
    if baseline is not None and baseline != first.row.key:
        scenes = {s.scene for s in group}
        base = [s for s in summaries if s.scene in scenes and (s.row.key, s.loss) == (baseline, first.loss)]
        for metric in by_seed if len(base) == len(group) else ():
            others = _mean_columns([s.by_seed[metric] for s in base])
            if len(others) == len(by_seed[metric]):
                delta[metric] = Estimate.of([a - b for a, b in zip(by_seed[metric], others, strict=True)])
    return Summary(
        scene=f"mean of {len(group)} scenes{description}",
        dataset=first.dataset,
        row=first.row,
        loss=first.loss,
        figures={metric: Estimate.of(values) for metric, values in by_seed.items()},
        exact=all(s.exact for s in group),
        delta=delta,
        by_seed=by_seed,
        by_view={},
        view_range={},
        num_bytes=round(statistics.fmean(s.num_bytes for s in group)),
        parts={},
        num_packets=round(statistics.fmean(s.num_packets for s in group)),
        elements=common_word(s.elements for s in group),
        num_anchors=round(statistics.fmean(s.num_anchors for s in group)),
        num_gaussians=_mean_count([s.num_gaussians for s in group]),
        lost_packets=statistics.fmean(s.lost_packets for s in group),
        lost_anchors=statistics.fmean(s.lost_anchors for s in group),
        lost_datagrams=None,
        seconds={},
        references=first.references,
    )


@dataclass(frozen=True)
class Ordering:
    """PSNR difference of two methods, as published and as measured here.

    Attributes:
        scene: The scene.
        loss: The loss.
        better: Label of the method with the higher published PSNR.
        worse: Label of the method with the lower published PSNR.
        dataset: Group of scenes in the publication.
        published: Published difference, dB.
        ours: Paired difference measured here, dB.
    """

    scene: str
    loss: Loss | None
    better: str
    worse: str
    dataset: str
    published: float
    ours: Estimate

    @property
    def verdict(self) -> str:
        """Result of comparing the measured order of two methods with the published one.

        `holds`, `opposite`, or, if the measured difference is not significant, `undecided`.
        """
        margin = self.ours.half_width
        if margin is None or abs(self.ours.mean) <= margin:
            return "undecided"
        return "holds" if self.ours.mean > 0 else "opposite"


def orderings(result: StudyResult, summaries: Sequence[Summary]) -> list[Ordering]:
    """Compares the published order by PSNR with the measured order, for each scene and each pair of methods."""
    # Neighbours in the table come first. Equal published values imply no order and are skipped.
    ordered = []
    for dataset in dict.fromkeys(entry.dataset for entry in result.study.published):
        values = {
            p.row: p.values["psnr"] for p in result.study.published if p.dataset == dataset and "psnr" in p.values
        }
        rows = [row for row in result.study.lossy_rows if row.key in values]
        for one, two in _pairs(rows):
            if values[one.key] == values[two.key]:
                continue
            better, worse = (two, one) if values[two.key] >= values[one.key] else (one, two)
            for a in summaries:
                if a.row.key != better.key or "psnr" not in a.by_seed:
                    continue
                b = next((s for s in summaries if (s.scene, s.loss, s.row.key) == (a.scene, a.loss, worse.key)), None)
                pairs = () if b is None else tuple(zip(a.by_seed["psnr"], b.by_seed["psnr"], strict=True))
                if (ours := Estimate.of([x - y for x, y in pairs])) is not None:
                    published = values[better.key] - values[worse.key]
                    ordered.append(Ordering(a.scene, a.loss, better.label, worse.label, dataset, published, ours))
    return ordered


def _pairs(rows: Sequence[Row]) -> list[tuple[Row, Row]]:
    """Returns all pairs of methods; pairs of neighbours in the table come first."""
    pairs = itertools.combinations(range(len(rows)), 2)
    return [(rows[a], rows[b]) for a, b in sorted(pairs, key=lambda pair: pair[1] - pair[0] > 1)]


def streams_of(summaries: Sequence[Summary], scene: str) -> dict[str, Summary]:
    """Returns a summary for each distinct stream of a scene, by name of the stream.

    If several methods use the same stream, the summary is that of the first.
    """
    # If several rows use the same stream, that of the first.
    streams: dict[str, Summary] = {}
    for s in (s for s in summaries if not s.row.decoded):  # the parts of another codec's bytes are unknown
        is_listed = any((s.row.variant, s.parts) == (o.row.variant, o.parts) for o in streams.values())
        if s.scene == scene and s.parts and not is_listed:
            streams[s.row.variant if s.row.variant not in streams else f"{s.row.variant} for {s.row.label}"] = s
    return streams


def _over_views(run: list[Record], metric: str) -> float:
    return statistics.fmean(value for record in run if (value := record.figure(metric)) is not None)


def _values_by_view(runs: list[list[Record]], metric: str) -> list[tuple[float, ...]]:
    """Converts the records of each seed to the values of one metric, grouped by view.

    Args:
        runs: Records (scores per view) of each seed.
        metric: Name of the metric.

    Returns:
        One tuple for each evaluated view, with one value for each seed.
    """
    columns = zip(*([record.figure(metric) for record in run] for run in runs), strict=True)
    return [column for column in columns if column[0] is not None]


def _ends(columns: list[tuple[float, ...]]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple(map(min, columns)), tuple(map(max, columns))


def _mean_columns(rows: Sequence[Sequence[float]]) -> tuple[float, ...]:
    return tuple(statistics.fmean(column) for column in zip(*rows, strict=True))


def _mean_count(counts: Sequence[int | None]) -> int | None:
    """Returns the rounded mean; None if a count is unknown."""
    known = [count for count in counts if count is not None]
    return round(statistics.fmean(known)) if len(known) == len(counts) else None


def _share(runs: list[list[Record]], part: str, whole: str) -> float | None:
    shares = [(getattr(run[0], part), getattr(run[0], whole)) for run in runs]
    return None if shares[0][0] is None else statistics.fmean(lost / max(1, sent) for lost, sent in shares)


def _seconds(runs: list[list[Record]]) -> dict[str, float]:
    def mean(name: str, views: int | None) -> float:
        return statistics.fmean(sum(getattr(record, f"seconds_{name}") for record in run[:views]) for run in runs)

    return {"decode": mean("decode", 1), "conceal": mean("conceal", 1)} | {
        n: mean(n, None) for n in ("render", "score")
    }
