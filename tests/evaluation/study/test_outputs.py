"""Means, intervals, paired differences, orderings, and every output file of a protocol."""

import csv
import dataclasses
import html
import io
import json
import math
import warnings

import numpy as np
import pytest

from splatwire.evaluation.study import (
    InProcess,
    SceneEntry,
    Store,
    load_study,
    measure_study_sizes,
    run_study,
    summarize,
    write_outputs,
    write_size_outputs,
)
from splatwire.evaluation.study.charts import bytes_chart, rate_chart, seeds_chart, views_chart
from splatwire.evaluation.study.curves import Curve
from splatwire.evaluation.study.definition import Published
from splatwire.evaluation.study.lead import percent_text
from splatwire.evaluation.study.pictures import take_pictures
from splatwire.evaluation.study.records import parquet
from splatwire.evaluation.study.sizes import SceneSizes, native_attribute_files, native_parts, size_tables
from splatwire.evaluation.study.summary import Estimate, dataset_means, orderings
from splatwire.evaluation.study.tables import Table, result_tables

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


def silent(task, share):
    pass


@pytest.fixture(scope="module")
def done(tiny_folder, tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("store"))
    return store, run_study(load_study(tiny_folder / "protocol.toml"), store, InProcess(), silent)


@pytest.fixture(scope="module")
def files(done, tmp_path_factory):
    store, result = done
    return write_outputs(result, store, tmp_path_factory.mktemp("out"))


def test_intervals_agree_with_scipy():
    from scipy import stats  # its import takes a second, which each test process would spend

    values = [20.1, 21.7, 19.9, 22.4, 20.8]
    estimate = Estimate.of(values)
    low, high = stats.t.interval(0.95, 4, np.mean(values), stats.sem(values))
    assert (estimate.mean - estimate.half_width, estimate.mean + estimate.half_width) == pytest.approx((low, high))
    assert estimate.spread == pytest.approx(np.std(values, ddof=1))
    assert Estimate.of([math.inf, 1.0]) is None
    assert Estimate.of([3.0]) == Estimate(3.0, None, None)


def test_means_are_over_views_then_seeds_and_differences_are_paired(done):
    _, result = done
    found = {summary.row.key: summary for summary in summarize(result)}
    scores = {}
    for record in result.merged():
        scores.setdefault(record["row"], {}).setdefault(record["seed"], []).append(record["psnr"])
    idw, drop = ([float(np.mean(scores[key][seed])) for seed in (0, 3)] for key in ("idw", "drop"))
    assert found["idw"].by_seed["psnr"] == pytest.approx(idw)
    assert found["idw"].delta["psnr"].mean == pytest.approx(np.mean(idw) - np.mean(drop))
    assert found["idw"].delta["psnr"].spread == pytest.approx(np.std(np.subtract(idw, drop), ddof=1))
    assert found["drop"].delta == {}
    assert found["reference"].figures["psnr"] is None


def test_reported_bytes_equal_the_file_size(done):
    store, result = done
    for summary in summarize(result):
        stream = result.scenes["made up"].streams[summary.row.variant]
        assert summary.num_bytes == (store.root / stream.path).stat().st_size == sum(summary.parts.values())


def test_ordering_states_the_measured_figures(done):
    _, result = done
    (found,) = orderings(result, summarize(result))
    assert (found.better, found.worse, found.published) == ("IDW", "none", 2.5)
    by_key = {summary.row.key: summary.by_seed["psnr"] for summary in summarize(result)}
    expected = Estimate.of(list(np.subtract(by_key["idw"], by_key["drop"])))
    assert found.ours.mean == pytest.approx(expected.mean)
    decided = abs(expected.mean) > expected.half_width
    assert found.verdict == (("holds" if expected.mean > 0 else "opposite") if decided else "undecided")


def _published(result, **values):
    entries = tuple(Published(row, "Paper scenes", {"psnr": value}) for row, value in values.items())
    return dataclasses.replace(result, study=dataclasses.replace(result.study, published=entries))


def test_every_pair_of_published_rows_is_compared(done):
    result = _published(done[1], contiguous=19.0, drop=20.0, idw=22.5)
    found = orderings(result, summarize(result))
    assert [(o.better, o.worse, o.published) for o in found] == [
        ("none", "contiguous, none", 1.0), ("IDW", "none", 2.5), ("IDW", "contiguous, none", 3.5)
    ]  # fmt: skip


def test_rows_with_equal_figures_have_no_ordering(done):
    result = _published(done[1], contiguous=20.0, drop=20.0)
    assert orderings(result, summarize(result)) == []


def test_photo_and_render_references_have_separate_means(done):
    result, rows = done[1], summarize(done[1])
    assert {summary.references for summary in rows} == {"renders"}
    scenes = {"a": "photos", "b": "photos", "c": "renders", "d": "renders", "e": "renders"}
    every = [
        dataclasses.replace(summary, scene=name, references=kind) for name, kind in scenes.items() for summary in rows
    ]
    found = [summary for summary in dataset_means(result, every) if summary.row.key == "drop"]
    assert [summary.scene for summary in found] == [
        "mean of 2 scenes of made up against photos", "mean of 3 scenes of made up against renders"
    ]  # fmt: skip
    alike = [dataclasses.replace(summary, references="photos") for summary in every]
    assert {summary.scene for summary in dataset_means(result, alike)} == {"mean of 5 scenes of made up"}


def test_renders_of_another_scene_are_references_of_their_own_kind(done, tmp_path):
    """Their figures include the error of the encoding, like those of photos and unlike those of own renders."""
    references = done[1].scenes["made up"].references
    kinds = []
    for renders, reference in (("", None), ("", tmp_path), ("inputs/x", None), ("inputs/x", tmp_path)):
        entry = dataclasses.replace(references.entry, reference=reference)
        kinds.append(dataclasses.replace(references, renders=renders, entry=entry).kind)
    assert kinds == ["photos", "photos", "renders", "reference scenes"]
    assert references.size == (48, 36)


def test_published_figures_are_listed_next_to_measured_ones(done):
    (table,) = result_tables(done[1], summarize(done[1]))
    column = table.columns.index("paper: Paper scenes")
    assert [row[column] for row in table.rows] == ["", "", "20.00", "22.50"]
    assert table.rows[0][1] == "= reference"


def test_every_output_file_exists_and_agrees(done, files):
    _, result = done
    merged = result.merged()
    assert parquet()[0].read_table(files["parquet"]).to_pylist() == merged
    lines = list(csv.DictReader(io.StringIO(files["records"].read_text())))
    assert [float(line["psnr"]) for line in lines] == [record["psnr"] for record in merged]
    content = json.loads(files["json"].read_text(), parse_constant=lambda name: pytest.fail(name))
    assert [row["row"] for row in content["rows"]] == ["reference", "contiguous", "drop", "idw"]
    page = files["report"].read_text()
    assert page.count("<svg") == 3  # seeds, views, bytes
    for words in ("Does the paper&#39;s order hold?", "Two units of loss", "bernoulli:0.05"):
        assert words in page.replace("paper's", "paper&#39;s")
    assert 'src="http' not in page
    assert r"\toprule" in files["latex"].read_text()
    assert len(list((files["report"].parent / "pictures").glob("*.png"))) == 2 * 5 + 2


def test_leaderboard_has_the_usual_columns(files):
    lines = list(csv.reader(io.StringIO((files["report"].parent / "leaderboard" / "made_up.csv").read_text())))
    assert lines[0] == ["Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians"]
    assert len(lines) == 5
    assert int(lines[1][4]) > 0 < int(lines[1][5])


def test_latex_and_markdown_escape_special_characters():
    table = Table("A & B", ("row_1", "10 %"), (("a|b", "1 ± 2"),), best=0)
    assert r"\caption{A \& B}" in table.latex()
    assert r"\textbf{1 $\pm$ 2}" in table.latex()
    assert r"row\_1 & 10 \%" in table.latex()
    assert r"| **a\|b** | **1 ± 2** |" in table.markdown()
    odd = Table("A\nB", ("row|1", "b\nc"), (("a", "b\r\nc"),))
    assert odd.markdown().splitlines() == ["### A B", "", r"| row\|1 | b c |", "|---|---:|", "| a | b c |"]
    assert odd.markdown().splitlines()[0] == "### A B"


@pytest.mark.parametrize("name", [r"$\frac{$", "a$b$c", "_hidden", "50 % & <b>", "\N{CJK UNIFIED IDEOGRAPH-573A}"])
def test_charts_show_names_as_they_are(done, name):
    """Neither as a formula nor left out of the legend, and without warnings about the font."""
    summaries = [
        dataclasses.replace(summary, row=dataclasses.replace(summary.row, label=name, curve=name))
        for summary in summarize(done[1])
        if summary.row.key in ("drop", "idw")
    ]
    views = done[1].scenes["made up"].references.names
    shown = html.escape(name, quote=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        charts = [
            seeds_chart(summaries), views_chart(summaries, [name] * len(views)), bytes_chart({name: summaries[0]}),
            rate_chart([Curve(name, "a", "", tuple(summaries))]),
        ]  # fmt: skip
    assert [shown in (chart or "") for chart in charts] == [True] * 4


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (0.0004, "0.04 %"), (0.004, "0.4 %"), (0.0123, "1 %"), (0.2, "20 %"), (0.9951, "99.5 %"),
     (0.99996, "over 99.9 %"), (1.0, "100 %")],
)  # fmt: skip
def test_shares_that_are_not_zero_are_not_shown_as_zero(share, text):
    assert percent_text(share) == text


def test_reported_sizes_equal_file_sizes(edited, tmp_path):
    """The parts of a column add up to the file; without official files there is no comparison."""
    path = edited(('name = "tiny"', 'kind = "sizes"'), ('label = "none"', 'label = "none"\npreset = "hacpp"'))
    study = load_study(path)
    (sizes,) = measure_study_sizes(study, Store(tmp_path / "store"), silent)
    files = list((tmp_path / "store").rglob("*.swz"))
    totals = {sum(parts.values()) for parts in sizes.columns.values()}
    assert totals == {file.stat().st_size for file in files}
    assert sizes.growth("IDW") is sizes.file_growth("IDW") is None
    assert all(min(parts.values()) > 0 for parts in sizes.columns.values())
    found = write_size_outputs(study, [sizes], tmp_path / "out")
    assert "sum, weights in" in found["report"].read_text()


def test_attribute_erosion_is_compared_with_the_papers_figure(edited):
    """Packet files against feature, scaling and offset files; the paper has no figure for the other measure."""
    published = '\n[[published]]\ndataset = "19 scenes"\nrow = "drop"\nattribute_growth_percent = 7.13\n'
    study = load_study(edited(('name = "tiny"', 'kind = "sizes"'), ("[[row]]", published + "[[row]]")))
    parts = ("positions and bounds", "hash grid", "attributes and masks", "headers and bookkeeping", "networks")
    columns = {"HAC++ files": (50, 20, 1000, 0, 30), "none": (40, 15, 990, 30, 5)}
    by_part = {name: dict(zip(parts, sizes, strict=True)) for name, sizes in columns.items()}
    sizes = SceneSizes("x", 7, by_part, {"HAC++ files": 900, "none": 1008})
    scene, growth = size_tables(study, [sizes])
    assert sizes.file_growth("none") == pytest.approx(12.0)
    assert ("files with attributes, against HAC++", "+0.00 %", "+12.00 %") in scene.rows
    assert ("attributes and masks alone, against HAC++", "+0.00 %", "-1.00 %") in scene.rows
    assert growth.rows == (
        ("none: files with attributes", "+7.13 % (19 scenes)", "+12.00 %"),
        ("none: attributes and masks alone", "", "-1.00 %"),
    )


@pytest.mark.data
def test_official_files_are_counted_like_the_official_total(data_dir):
    """The official total counts bounds as 24 bytes, although their files are larger."""
    folder = data_dir / "hacpp" / "snowmiku_small_2400"
    parts = native_parts(SceneEntry("x", folder, "model", cameras=folder / "cameras.json"))
    marks = json.loads((folder / "metrics.json").read_text())
    bounds = sum((folder / "bitstreams" / f"x_bound_{end}.pkl").stat().st_size for end in ("min", "max"))
    assert sum(parts.values()) - bounds + 24 == marks["total_bytes_files_plus_mlps"]
    assert parts["networks"] == marks["bytes"]["mlps_fp32_counted"]
    masks = sum(file.stat().st_size for file in (folder / "bitstreams").iterdir() if file.name.startswith("masks"))
    assert native_attribute_files(SceneEntry("x", folder, "model")) == parts["attributes and masks"] - masks > 0


def test_saved_pictures_equal_the_scored_ones(done):
    """Saved pictures are the workers' renders of the worst views of the baseline under its worst loss."""
    store, result = done
    images = result.report_images["made up"]
    (baseline,) = [cell for cell in result.cells if cell.row.key == "drop" and cell.seed == 0]
    psnr = [record.psnr for record in result.records[baseline.unit.key]]
    assert list(images.views) == sorted(range(2), key=psnr.__getitem__)
    for picture, view in zip(take_pictures(result, store), images.views, strict=True):
        assert [shot.label for shot in picture.shots] == [row.label for row in result.study.rows]
        cells = [cell for cell in result.cells if cell.seed in (None, 0)]
        for shot, cell in zip(picture.shots, cells, strict=True):
            assert shot.psnr == result.records[cell.unit.key][view].psnr
            if cell.row.lossless:
                assert np.array_equal(shot.pixels, picture.reference)
            else:
                error = np.mean((shot.pixels / 255.0 - picture.reference / 255.0) ** 2)
                assert -10 * np.log10(error) == pytest.approx(shot.psnr, abs=0.1)
        assert set(picture.loss_maps) == (
            {"paper-block_size=60", "paper-block_size=60-contiguous"} if view == images.views[0] else set()
        )


def test_saved_pictures_show_the_worst_loss(edited, tmp_path):
    """Pictures of a very small loss would show no difference."""
    mild, store = '[[loss]]\nmodel = "bernoulli:0.05"\n\n', Store(tmp_path)
    result = run_study(load_study(edited(("[[loss]]", mild + "[[loss]]"))), store, InProcess(), silent)
    assert result.report_images["made up"].loss.model == "bernoulli:0.3"
    assert {view.loss for view in take_pictures(result, store)} == {"bernoulli:0.3 per packet, seed 0"}


def test_missing_pictures_are_rendered_again(done, tmp_path):
    """A report needs records and pictures. Missing pictures are rendered again after a killed run or new seeds."""
    store, result = done
    shown = next(cell for cell in result.cells if cell.row.key == "idw" and cell.seed == 0)
    path = store.root / shown.unit.picture(0)
    before = path.read_bytes()
    path.unlink()
    again = run_study(result.study, store, InProcess(), silent)
    assert (again.num_computed, path.read_bytes()) == (1, before)
