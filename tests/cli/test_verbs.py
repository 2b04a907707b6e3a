"""The printed results of each verb."""

import json

import numpy as np
import pytest
from PIL import Image

from scenes import tiny_scene
from splatwire.anchors.scene_file import load_partial, load_scene
from splatwire.bitstream import read_stream
from splatwire.cli import _output
from splatwire.cli.main import main
from splatwire.types.scene_digest import scene_digest

ROW_KEYS = {"method", "psnr", "ssim", "lpips", "seconds", "num_bytes"}


def test_encode_counts_every_byte(run, journey, tmp_path):
    content = run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", "--json").json
    assert content["num_bytes"] == (tmp_path / "a.swz").stat().st_size == sum(content["parts"].values())
    assert content["num_elements"] == 240
    assert content["num_packets"] == len(read_stream(tmp_path / "a.swz")[0].packets)


def test_encode_accepts_a_packetization(run, journey, tmp_path):
    words = ("--block-size", 100, "--lanes", 4, "--preset", "hacpp")
    assert run("encode", journey / "tiny.scene", "-o", tmp_path / "a", *words).status == 0
    packetization = run("inspect", tmp_path / "a", "--json").json["packetization"]
    asked = {"block_size": 100, "lanes": 4, "order": "raster"}
    assert asked.items() <= packetization.items()


@pytest.mark.parametrize(
    ("words", "block_size", "lanes"),
    [
        ((), 240, 8),  # all anchors in one block, so lanes span the whole scene
        (("--preset", "spread"), 240, 8),
        (("--preset", "paper"), 3000, 8),
        (("--block-size", 60), 60, 8),  # values of the paper where one of them is changed
        (("--lanes", 4), 3000, 4),
    ],
)
def test_lanes_of_anchors_span_the_whole_scene_by_default(run, journey, tmp_path, words, block_size, lanes):
    run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", *words)
    packetization = read_stream(tmp_path / "a.swz")[0].manifest.packetization
    assert (packetization.block_size, packetization.lanes) == (block_size, lanes)


@pytest.mark.needs_torch
@pytest.mark.slow
def test_encode_refines_the_context_model(run, journey, tmp_path):
    words = ("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", "--json", "--refine")
    sizes = [run(*words, steps).json["parts"]["packet_payloads"] for steps in (0, 80, 80)]
    assert sizes[1] < 0.97 * sizes[0]
    assert sizes[2] == sizes[1]
    outcome = run("encode", journey / "tiny.scene", "-o", tmp_path / "b.swz", "--refine", -1)
    assert outcome.status == 2
    assert "refinement" in outcome.err
    assert not (tmp_path / "b.swz").exists()


@pytest.mark.parametrize("preset", ["paper", "datagram"])
def test_encode_puts_important_anchors_into_separate_packets(run, journey, tmp_path, preset):
    words = ("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", "--preset", preset, "--tiers", 0.1, 0.2)
    content = run(*words, "--json").json
    assert [tier["num_elements"] for tier in content["tiers"].values()] == [24, 48, 168]
    inspected = run("inspect", tmp_path / "a.swz", "--json").json
    assert inspected["tiers"] == content["tiers"]
    assert inspected["side_info_parts"]["tiers"] > 0
    assert sum(tier["num_packets"] for tier in content["tiers"].values()) == content["num_packets"]
    for name in ("a.swz", "plain.swz"):
        source = tmp_path / name if name == "a.swz" else journey / "tiny.swz"
        assert run("decode", source, "-o", tmp_path / f"{name}.scene").status == 0
    digests = [scene_digest(load_partial(tmp_path / f"{name}.scene").scene.anchors) for name in ("a.swz", "plain.swz")]
    assert digests[0] == digests[1]


@pytest.mark.parametrize("words", [("--tiers", 0), ("--tiers", 0.6, 0.5), ("--tiers", 0.001)])
def test_impossible_tiers_are_refused(run, journey, tmp_path, words):
    outcome = run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", *words)
    assert outcome.status == 2
    assert "tier" in outcome.err
    assert not (tmp_path / "a.swz").exists()


def test_inspect_reports_a_stream(run, journey):
    content = run("inspect", journey / "tiny.swz", "--json").json
    assert content["kind"] == "stream"
    assert content["num_bytes"] == (journey / "tiny.swz").stat().st_size == sum(content["parts"].values())
    assert content["num_elements"] == 240
    assert content["num_packets"] == content["num_packets_expected"] == 32
    assert sum(content["side_info_parts"].values()) == content["parts"]["side_info"]


def test_a_folder_and_a_file_have_the_same_content(run, journey):
    file, folder = (run("inspect", journey / name, "--json").json for name in ("tiny.swz", "packets"))
    assert file == folder


def test_inspect_prints_a_table(run, journey):
    outcome = run("inspect", journey / "tiny.swz")
    assert "side_info" in outcome.out
    assert outcome.status == 0


def test_transmit_reports_lost_packets(run, journey, tmp_path):
    content = run("transmit", journey / "tiny.swz", "-o", tmp_path / "a", "--loss", "bernoulli:0.3", "--json").json
    assert content["unit"] == "pak"
    assert content["num_sent"] == 32
    assert 0 < content["num_lost"] < 32
    assert len(list((tmp_path / "a").glob("*.pak"))) == 32 - content["num_lost"]
    assert run("inspect", tmp_path / "a", "--json").json["num_lost_packets"] == content["num_lost"]


def test_deleted_packet_files_count_as_losses(run, journey, tmp_path):
    run("transmit", journey / "packets", "-o", tmp_path / "a", "--loss", "none")
    (tmp_path / "a" / "pak_lane0_s0.pak").unlink()
    content = run("decode", tmp_path / "a", "-o", tmp_path / "a.scene", "--json").json
    assert content["packets"]["num_missing"] == 1
    assert 0 < content["num_lost"] < 60


def test_decode_without_loss_restores_the_scene(run, journey, tmp_path):
    content = run("decode", journey / "tiny.swz", "-o", tmp_path / "a.scene", "--json").json
    assert content["num_lost"] == 0
    decoded = load_partial(tmp_path / "a.scene").scene.anchors
    original = tiny_scene(seed=3, num_anchors=240).anchors
    rank = {tuple(position): i for i, position in enumerate(original.positions.tolist())}
    index = [rank[tuple(position)] for position in decoded.positions.tolist()]
    assert sorted(index) == list(range(240))
    assert (decoded.mask == original.mask[index]).all()
    assert np.abs(decoded.features - original.features[index]).max() < 1.01  # half a step, which is below 2


def test_a_decoded_scene_without_gaps_can_be_encoded_again(run, journey, tmp_path, capsys):
    run("decode", journey / "tiny.swz", "-o", tmp_path / "a.scene")
    assert run("encode", tmp_path / "a.scene", "-o", tmp_path / "a.swz", "--json").json["num_elements"] == 240
    run("decode", journey / "lossy.swz", "-o", tmp_path / "b.scene")
    with pytest.raises(SystemExit) as stopped:
        main(["encode", str(tmp_path / "b.scene"), "-o", str(tmp_path / "b.swz")])
    assert stopped.value.code == 2
    assert "of the scene's 240 anchors were lost; conceal it first" in capsys.readouterr().err


def test_inspect_reports_a_decoded_scene(run, journey, tmp_path):
    decoded = run("decode", journey / "lossy.swz", "-o", tmp_path / "a.scene", "--json").json
    content = run("inspect", tmp_path / "a.scene", "--json").json
    assert content["digest"] == decoded["digest"] == scene_digest(load_partial(tmp_path / "a.scene").scene.anchors)
    assert content["num_lost"] == decoded["num_lost"] > 0
    assert content["num_bytes"] == (tmp_path / "a.scene").stat().st_size == sum(content["parts"].values())
    assert content["num_anchors"] == 240
    assert content["kind"] == "partial scene"


@pytest.mark.needs_torch
def test_concealed_scene_keeps_its_loss_mask(run, journey, tmp_path):
    decoded = run("decode", journey / "lossy.swz", "-o", tmp_path / "a.scene", "--conceal", "idw", "--json").json
    content = run("inspect", tmp_path / "a.scene", "--json").json
    assert content["kind"] == "scene"
    assert content["num_lost"] == decoded["num_lost"] > 0
    assert load_scene(tmp_path / "a.scene").hints is not None


def test_render_writes_one_picture_per_view(run, journey, tmp_path):
    words = ("render", journey / "tiny.scene", "--cameras", journey / "cameras.json", "-o", tmp_path / "pictures")
    content = run(*words, "--json").json
    assert content["pictures"] == ["view_00.png", "view_01.png"]
    picture = np.asarray(Image.open(tmp_path / "pictures" / "view_00.png"))
    assert picture.shape == (48, 64, 3)
    assert picture.std() > 10
    again = run("render", journey / "tiny.scene", "--cameras", tmp_path / "pictures" / "cameras.json", "-o", tmp_path)
    assert again.status == 0
    assert (tmp_path / "view_00.png").read_bytes() == (tmp_path / "pictures" / "view_00.png").read_bytes()


def test_render_scales_pictures_and_accepts_streams(run, journey, tmp_path):
    words = ("--cameras", journey / "cameras.json", "--scale", 0.5, "-o", tmp_path, "--json")
    content = run("render", journey / "lossy.swz", *words).json
    assert (content["width"], content["height"]) == (32, 24)
    assert content["num_lost"] > 0


def _evaluate(run, journey, source, *words):
    reference = ("--reference", journey / "tiny.swz", "--cameras", journey / "cameras.json", "--json")
    return run("evaluate", source, *reference, *words).json


@pytest.mark.needs_torch
def test_evaluate_prints_one_row_per_concealer_and_loss(run, journey):
    content = _evaluate(
        run, journey, journey / "tiny.swz", "--loss", "bernoulli:0.3", "--seeds", 0, 1, "--conceal", "idw", "drop",
        "--contiguous",
    )  # fmt: skip
    rows = content["rows"]
    assert [row["method"] for row in rows] == ["no loss", "contiguous drop", "drop", "idw"]
    assert all(set(row) >= ROW_KEYS for row in rows)
    assert rows[0]["psnr"] is None
    assert rows[0]["exact"]
    assert all(5 < row["psnr"] < 60 and 0 < row["ssim"] < 1 for row in rows[1:])
    assert all(len(row["psnr_by_seed"]) == 2 for row in rows[1:])
    assert rows[2]["num_lost"] == rows[3]["num_lost"] > 0
    assert rows[2]["num_bytes"] == (journey / "tiny.swz").stat().st_size == sum(rows[2]["parts"].values())
    assert content["unit"] == "pak"


def test_evaluate_accepts_an_already_lossy_stream(run, journey, tmp_path):
    rows = _evaluate(run, journey, journey / "lossy.swz", "--conceal", "drop")["rows"]
    run("decode", journey / "lossy.swz", "-o", tmp_path / "gaps.scene")
    run("decode", journey / "lossy.swz", "-o", tmp_path / "drop.scene", "--conceal", "drop")
    gaps = _evaluate(run, journey, tmp_path / "gaps.scene", "--conceal", "drop")["rows"]
    drop = _evaluate(run, journey, tmp_path / "drop.scene")["rows"]
    assert [row["method"] for row in (*rows, *gaps, *drop)] == ["drop", "drop", "as it is"]
    assert rows[0]["psnr"] == gaps[0]["psnr"] == drop[0]["psnr"]


@pytest.mark.parametrize("loss", ["bernoulli:0", "bernoulli:1"])
def test_loss_rates_zero_and_one_are_accepted(run, journey, loss):
    rows = _evaluate(run, journey, journey / "tiny.swz", "--loss", loss)["rows"]
    for row in rows[1:]:
        assert row["num_lost"] == (0 if loss.endswith("0") else 240)
        assert (row["psnr"] is None) == loss.endswith("0")
        assert row["exact"] == loss.endswith("0")


def test_evaluate_writes_a_report(run, journey, tmp_path):
    words = ("--loss", "bernoulli:0.3", "--conceal", "drop", "-o", tmp_path / "report")
    content = _evaluate(run, journey, journey / "tiny.swz", *words)
    assert content["report"] == str(tmp_path / "report" / "report.html")
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    assert results["rows"][1]["psnr"] == content["rows"][1]["psnr"]


def test_progress_goes_to_standard_error(run, journey, tmp_path):
    outcome = run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", "--json")
    assert "encoding" in outcome.err
    assert len(outcome.out.splitlines()) == 1


def test_progress_without_a_terminal_is_printed_at_intervals(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(_output.time, "perf_counter", lambda: now[0])
    with _output.progress_bars() as report:
        for second in range(35):
            now[0] = float(second)
            report("encoding frames", second / 35)
        report("encoding frames", 1.0)
        report("writing", 0.0)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split("] ")[1] for line in lines] == [
        "encoding frames", "encoding frames: 29%", "encoding frames: 57%", "encoding frames: 86%", "writing"
    ]  # fmt: skip
