"""Fair comparison: shared losses, shared decodes, means in the right order, and the report of one scene."""

import dataclasses
import json
import math
import re
import statistics

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import save_partial
from splatwire.bitstream import Packetization, read_stream, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import conceal
from splatwire.data import load_cameras, save_cameras
from splatwire.errors import SplatwireError
from splatwire.evaluation.study import (
    InProcess,
    Loss,
    MemoryStore,
    Row,
    SceneEntry,
    Study,
    concealment_rows,
    plain_content,
    run_loss_curve,
    run_study,
    summarize,
    write_report,
)
from splatwire.evaluation.study import inputs as study_inputs
from splatwire.evaluation.study.lead import terms_of
from splatwire.evaluation.study.pictures import take_pictures
from splatwire.evaluation.study.tables import Table
from splatwire.metrics import psnr
from splatwire.render import render_scene

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]

PACKETIZATION = Packetization(block_size=60)
LOSS = Loss("bernoulli:0.3")


def silent(task, share):
    pass


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plain")
    write_stream(encode_scene(tiny_scene(seed=5, num_anchors=180), PACKETIZATION), folder / "tiny.swz")
    save_cameras(tiny_cameras(3, 48, 36), folder / "cameras.json")
    return folder


@pytest.fixture(scope="module")
def stream(folder):
    return read_stream(folder / "tiny.swz")[0]


def plain_study(folder, rows, source="tiny.swz", kind="stream", **changes):
    entry = SceneEntry("tiny", folder / source, kind, cameras=folder / "cameras.json", reference=folder / "tiny.swz")
    settings = {"losses": (LOSS,), "seeds": (0, 4), "baseline": "drop", **changes}
    return Study("tiny", "A <title>", (entry,), rows, notes=("One note.",), **settings)


def run(study, folder, **options):
    store = MemoryStore(folder)
    return store, run_study(study, store, InProcess(**options), options.get("progress", silent))


@pytest.fixture(scope="module")
def evaluation(folder, tmp_path_factory):
    return run(plain_study(folder, concealment_rows(("drop", "idw"))), tmp_path_factory.mktemp("evaluation"))


@pytest.fixture(scope="module")
def rows(evaluation):
    return {row["method"]: row for row in plain_content(evaluation[1])["rows"]}


def records(result, key, seed):
    cell = next(cell for cell in result.cells if (cell.row.key, cell.seed) == (key, seed))
    return result.records[cell.unit.key]


def test_row_equals_calling_the_packages_step_by_step(stream, folder, evaluation):
    """The evaluation adds bookkeeping, never a different picture."""
    received, _ = transmit(stream, parse_loss("bernoulli:0.3"), seed=4)
    cameras = load_cameras(folder / "cameras.json")
    images = render_scene(conceal(decode_stream(received), "idw"), cameras)
    references = render_scene(decode_stream(stream).scene, cameras)
    found = records(evaluation[1], "idw", 4)
    assert [record.psnr for record in found] == pytest.approx(psnr(images, references).tolist(), abs=1e-5)
    assert found[0].num_lost_packets == len(stream.packets) - len(received.packets)
    assert found[0].num_bytes_received == received.num_bytes


def test_rows_share_the_same_losses(rows):
    assert rows["drop"]["num_lost"] == rows["idw"]["num_lost"] > 0


def test_psnr_is_averaged_over_views_and_then_seeds(rows, evaluation):
    runs = [records(evaluation[1], "drop", seed) for seed in (0, 4)]
    means = [statistics.fmean(record.psnr for record in run) for run in runs]
    assert rows["drop"]["psnr_by_seed"] == means
    assert rows["drop"]["psnr"] == statistics.fmean(means)
    assert rows["drop"]["psnr_spread"] == statistics.stdev(means)
    assert rows["drop"]["psnr_by_view"] == [statistics.fmean(r.psnr for r in pair) for pair in zip(*runs, strict=True)]


def test_infinite_psnr_is_null_in_json_and_reported(rows, evaluation):
    assert rows["no loss"]["psnr"] is None
    assert rows["no loss"]["exact"]
    assert all(math.isinf(record.psnr) for record in records(evaluation[1], "no loss", None))


def test_report_explains_infinite_means():
    table = Table("scene", ("row", "PSNR", "bytes"), (("drop", "infinite", "8"), ("sketch", "30.00", "9")))
    terms = dict(terms_of([table]))
    assert list(terms) == ["PSNR", "drop", "infinite", "sketch"]
    assert "equal their references" in terms["infinite"]


def test_each_received_stream_is_decoded_once(folder, tmp_path):
    calls = []

    def decode(received):
        calls.append(len(received.packets))
        return decode_stream(received)

    study = plain_study(folder, concealment_rows(("drop", "prior", "idw"), contiguous=dataclasses.replace(
        PACKETIZATION, grouping="contiguous")), seeds=(0, 1, 2))  # fmt: skip
    run(study, tmp_path, decode=decode)
    assert len(calls) == 3 + 1 + 3  # three seeds and the complete stream; three seeds of the contiguous one


def test_streams_with_equal_packet_counts_get_the_same_losses(folder, tmp_path):
    contiguous = dataclasses.replace(PACKETIZATION, grouping="contiguous")
    _, result = run(plain_study(folder, concealment_rows(("drop",), contiguous=contiguous), seeds=(2,)), tmp_path)
    one, two = (records(result, key, 2)[0] for key in ("drop", "contiguous drop"))
    assert one.num_packets == two.num_packets
    assert one.mask == two.mask
    assert one.num_lost_packets == two.num_lost_packets > 0


def test_pictures_show_the_worst_views_of_the_baseline(evaluation):
    store, result = evaluation
    drop = [record.psnr for record in records(result, "drop", 0)]
    hardest = sorted(range(3), key=drop.__getitem__)[:2]
    pictures = take_pictures(result, store)
    assert [picture.view for picture in pictures] == [f"view_{view:02d}" for view in hardest]
    for picture in pictures:
        assert [shot.label for shot in picture.shots] == ["no loss", "drop", "idw"]
        assert np.array_equal(picture.shots[0].pixels, picture.reference)
    assert [list(picture.loss_maps) for picture in pictures] == [["stream"], []]


def test_progress_ends_at_one_for_every_row(folder, tmp_path):
    seen = {}
    study = plain_study(folder, concealment_rows(("drop",)))
    run(study, tmp_path, progress=lambda task, share: seen.update({task: share}))
    assert {task: share for task, share in seen.items() if "scoring" in task} == {
        "drawing and scoring 'drop'": 1.0,
        "drawing and scoring 'no loss'": 1.0,
    }
    assert set(seen.values()) == {1.0}


def test_incomplete_scene_is_scored_without_more_losses(stream, folder, tmp_path, rows):
    received = decode_stream(transmit(stream, parse_loss("bernoulli:0.3"), seed=0)[0])
    save_partial(received, folder / "gaps.scene")
    names = concealment_rows(("drop", "idw"), complete=False)
    study = plain_study(folder, names, "gaps.scene", "scene", losses=(Loss("none"),), seeds=(0,))
    store, result = run(study, tmp_path)
    content = plain_content(result)
    assert [row["num_lost"] for row in content["rows"]] == [received.loss_mask.num_lost] * 2
    assert content["rows"][0]["num_bytes"] == (folder / "gaps.scene").stat().st_size
    assert [row["psnr"] for row in content["rows"]] == [rows[name]["psnr_by_seed"][0] for name in ("drop", "idw")]
    assert take_pictures(result, store)[0].loss_maps


def test_rows_have_the_usual_order():
    found = [row.key for row in concealment_rows(("mine", "grow", "idw", "drop")[1:], contiguous=PACKETIZATION)]
    assert found == ["no loss", "contiguous drop", "drop", "idw", "grow"]
    assert [row.key for row in concealment_rows(("drop", "idw", "drop"), complete=False)] == ["drop", "idw"]


@pytest.mark.parametrize("seeds", [(), (1, 1), (-1,), tuple(range(1001))])
def test_invalid_seeds_are_refused(folder, seeds):
    with pytest.raises(SplatwireError, match="seed"):
        plain_study(folder, concealment_rows(("drop",)), seeds=seeds)


@pytest.mark.parametrize("names", [(), ("a", "a")])
def test_invalid_rows_are_refused(folder, names):
    with pytest.raises(SplatwireError, match="row"):
        plain_study(folder, tuple(Row(name, name, None) for name in names), baseline=None)


def test_report_is_complete_and_self_contained(evaluation, rows, tmp_path):
    store, result = evaluation
    path = write_report(result, store, tmp_path / "out", {"rows": list(rows.values()), "more": 1})
    text = path.read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in text
    assert "One note." in text
    for row in rows.values():
        assert f"<td>{row['method']}</td>" in text
        assert row["psnr"] is None or f"{row['psnr']:.2f}" in text
    assert "equal to the reference" in text
    assert "weights are absent" in text
    # reference, pictures, errors; loss map; the two below the slider at the top
    assert text.count("data:image/jpeg;base64,") == 2 * (1 + 3 + 3) + 1 + 2
    assert text.count("<svg") == 3
    assert text.count("data-compare=") == 2
    addresses = set(re.findall(r"https?://[^\s\"'<)]+", text))
    assert all(
        "w3.org" in a or "purl.org" in a or "creativecommons.org" in a or "matplotlib.org" in a for a in addresses
    )
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"(?!data:)", text)
    content = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert content == {"rows": list(rows.values()), "more": 1}
    assert len(list((tmp_path / "out" / "pictures").iterdir())) == 2 * (1 + 3) + 1
    write_report(result, store, tmp_path / "out", {"second": 1})  # replaces the earlier one
    assert "second" in (tmp_path / "out" / "results.json").read_text(encoding="utf-8")
    assert not [path for path in (tmp_path / "out").iterdir() if path.name.endswith(".part")]


def test_report_starts_with_summary_pictures_and_curve(folder, tmp_path):
    contiguous = dataclasses.replace(PACKETIZATION, grouping="contiguous")
    rows = concealment_rows(("drop", "idw", "grow"), PACKETIZATION, contiguous=contiguous)
    store, result = run(plain_study(folder, rows, seeds=(0,)), tmp_path / "store")
    curve = run_loss_curve(result, store, InProcess(progress=silent), silent)
    labels = {row.key for row in curve.study.rows}
    assert "drop" in labels
    assert "idw" not in labels or len(labels) == 4
    assert [loss.model for loss in curve.study.losses] == ["bernoulli:0.05", "bernoulli:0.1", "bernoulli:0.5"]
    figures = {s.row.key: s for s in summarize(result) if s.loss is not None and s.row.key in labels}
    uncovered, best = (f(figures.values(), key=lambda s: s.figures["psnr"].mean) for f in (min, max))
    text = write_report(result, store, tmp_path / "out", {}, curve=curve).read_text(encoding="utf-8")
    sentence = re.search(r'<p class="lead">(.*?)</p>', text)[1]
    lost = uncovered.lost_packets  # of the loss in the title, not of the highest loss of the curve
    assert sentence.startswith(f"With {100 * lost:.0f} % of the packets lost")
    for summary in (uncovered, best):
        assert f"{summary.figures['psnr'].mean:.1f} dB" in sentence
        assert f"({summary.row.label})" in sentence
    places = [text.index(words) for words in ('class="lead"', "data-slider", "Quality over loss", "<svg", "Numbers")]
    assert places == sorted(places)
    shown = re.search(r'<figure class="slider">(.*?)</figure>', text, re.S)[1]
    left, right = re.findall(r'src="(data:[^"]+)"', shown)
    assert left != right
    assert "bernoulli:0.5" in shown
    losing = [s.row.label for s in summarize(result) if s.row.key == "idw" and s.delta["psnr"].mean < 0]
    for label in losing:
        assert text.index("do worse than drop") < text.index(f"<td>{label}</td>")
    assert "<dt>PSNR</dt>" in text
    assert text.index("One note.") > text.index("How this was measured")


def test_report_without_a_row_that_leaves_gaps_names_the_baseline(folder, tmp_path):
    """`evaluate --conceal` with methods that all fill the gaps."""
    names = ("prior", "idw", "grow")
    _, result = run(plan := plain_study(folder, concealment_rows(names), baseline="idw"), tmp_path / "first")
    psnr_of = {s.row.key: s.figures["psnr"].mean for s in summarize(result) if s.loss is not None}
    worst, middle, best = sorted(names, key=psnr_of.get)
    store, result = run(dataclasses.replace(plan, baseline=middle), tmp_path / "second")
    text = write_report(result, store, tmp_path / "out", {}).read_text(encoding="utf-8")
    sentence = re.search(r'<p class="lead">(.*?)</p>', text)[1]
    assert f"{psnr_of[middle]:.1f} dB with {middle} and at {psnr_of[best]:.1f} dB with {best}" in sentence
    assert "gaps" not in text
    assert text.index(f"do worse than {middle}<") < text.index(f"<td>{worst}</td>")


def test_report_without_losses_starts_with_its_quality(folder, tmp_path):
    write_stream(encode_scene(tiny_scene(seed=6)), tmp_path / "other.swz")
    rows = (Row("no_loss", "no loss", None, lossless=True),)
    study = plain_study(folder, rows, seeds=(0,), baseline=None)
    entry = dataclasses.replace(study.scenes[0], reference=tmp_path / "other.swz")
    store, result = run(dataclasses.replace(study, scenes=(entry,)), tmp_path / "store")
    (summary,) = summarize(result)
    text = write_report(result, store, tmp_path / "out", {}).read_text(encoding="utf-8")
    sentence = re.search(r'<p class="lead">(.*?)</p>', text)[1]
    assert f"at {summary.figures['psnr'].mean:.1f} dB with {summary.num_bytes:,} bytes" in sentence
    assert text.index("data-slider") < text.index("Numbers")


def test_a_stored_evaluation_repeats_its_warning_without_decoding(folder, tmp_path, monkeypatch, caplog):
    scene = tiny_scene(seed=5, num_anchors=180)
    far = dataclasses.replace(scene.anchors, positions=scene.anchors.positions + np.float32(50))
    write_stream(encode_scene(dataclasses.replace(scene, anchors=far)), tmp_path / "far.swz")
    study = plain_study(folder, (Row("no_loss", "no loss", None, lossless=True),), seeds=(0,), baseline=None)
    entry = dataclasses.replace(study.scenes[0], reference=tmp_path / "far.swz")

    def decoding(*_args):
        raise AssertionError("a finished evaluation decoded a scene")

    for _ in range(2):
        caplog.clear()
        run(dataclasses.replace(study, scenes=(entry,)), tmp_path / "store")
        assert caplog.text.count("is of another scene than") == 1
        for name in ("decode_stream", "drawable_scene"):
            monkeypatch.setattr(study_inputs, name, decoding)


@pytest.mark.parametrize("loss", ["none", "bernoulli:0", "trace"])
def test_report_without_rates_has_no_curve(folder, tmp_path, loss):
    (tmp_path / "trace.txt").write_text("1\n0\n1\n")
    model = f"trace:{tmp_path / 'trace.txt'},repeat" if loss == "trace" else loss
    rows = concealment_rows(("drop", "grow"), PACKETIZATION)
    store, result = run(plain_study(folder, rows, seeds=(0,), losses=(Loss(model),)), tmp_path / "store")
    assert run_loss_curve(result, store, InProcess(progress=silent), silent) is None
    assert "Numbers" in write_report(result, store, tmp_path / "out", {}).read_text(encoding="utf-8")


def test_view_names_cannot_leave_the_folder(folder, tmp_path):
    cameras = load_cameras(folder / "cameras.json").select([0, 1])
    sly = dataclasses.replace(cameras, names=("../../sly", "/etc/passwd"))
    save_cameras(sly, folder / "sly.json")
    study = plain_study(folder, concealment_rows(("drop",)), seeds=(0,))
    entry = dataclasses.replace(study.scenes[0], cameras=folder / "sly.json")
    store, result = run(dataclasses.replace(study, scenes=(entry,)), tmp_path / "store")
    write_report(result, store, tmp_path / "a" / "b", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "store"]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["b"]
