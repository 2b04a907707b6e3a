"""Loss models and metrics of installed packages in commands, studies and their workers."""

import csv
import json

import pytest

from distributions import install_page, run_with
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.codec import encode_scene
from splatwire.data import save_cameras

pytestmark = pytest.mark.slow

PROTOCOL = """
[protocol]
name = "own"
title = "own"
metrics = ["psnr", "mae"]
seeds = [0, 1]
[[scene]]
name = "tiny"
stream = "whole.swz"
cameras = "cameras.json"
[[loss]]
model = "every:3"
[[row]]
key = "swell"
label = "swell"
conceal = "swell"
block_size = 60
[[published]]
row = "swell"
dataset = "acme"
mae = 0.25
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    write_stream(encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60)), folder / "whole.swz")
    save_cameras(tiny_cameras(1, 32, 24), folder / "cameras.json")
    (folder / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    install_page("your-own-concealer.md", folder / "site")
    return folder


def run(folder, *words):
    return run_with(folder / "site", folder, *words)


def test_loss_model_of_a_package_loses_packets(folder):
    done = run(folder, "transmit", "whole.swz", "-o", "lossy.swz", "--loss", "every:4", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert (content["num_sent"], content["num_lost"], content["loss"]) == (16, 4, "every:4")
    done = run(folder, "transmit", "whole.swz", "-o", "lossy.swz", "--loss", "every:x")
    assert done.returncode == 2
    assert "'every:x' should look like every:N: invalid literal for int()" in done.stderr


def test_metric_of_a_package_is_in_an_evaluation(folder, monkeypatch):
    for name in ("DIR", "BACKBONE", "LINEAR"):  # LPIPS would be in the evaluation, too
        monkeypatch.delenv(f"SPLATWIRE_LPIPS_{name}", raising=False)
    words = ("evaluate", "whole.swz", "--reference", "whole.swz", "--cameras", "cameras.json", "--loss", "every:3",
             "--conceal", "drop")  # fmt: skip
    done = run(folder, *words, "--json")
    assert done.returncode == 0, done.stderr
    whole, drop = json.loads(done.stdout)["rows"]
    assert whole["metrics"] == {"mae": 0}
    assert drop["metrics"]["mae"] > 0
    done = run(folder, *words)
    assert "MAE" in done.stdout


def test_study_and_workers_use_plugin_losses_and_metrics(folder):
    done = run(folder, "study", "study.toml", "-o", "out", "--engine", "local", "--workers", "1")
    assert done.returncode == 0, done.stderr
    table = (folder / "out" / "tables.md").read_text()
    assert "| row | PSNR | MAE |" in table
    assert "0.250" in table
    with (folder / "out" / "records.csv").open() as file:
        records = list(csv.DictReader(file))
    assert {record["loss"] for record in records} == {"every:3"}
    assert all(float(record["mae"]) > 0 for record in records)
    again = run(folder, "study", "study.toml", "-o", "out", "--json")
    assert json.loads(again.stdout)["num_computed"] == 0


def test_metric_that_is_not_installed_is_named_before_the_work(folder, tmp_path):
    text = (folder / "study.toml").read_text().replace('"swell"', '"drop"').replace("every:3", "bernoulli:0.5")
    (folder / "bare.toml").write_text(text)
    done = run_with(tmp_path, folder, "study", "bare.toml", "-o", "other")
    assert done.returncode == 2
    assert "unknown metric 'mae': known are lpips, lpips_unscaled, psnr, ssim" in done.stderr
