"""Sequences in studies: temporal concealers, those of packages among them, in every worker."""

import csv

import pytest

from distributions import install_page, run_with
from moving_sequences import moving_frames
from splatwire.bitstream import write_stream
from splatwire.io.formats import write_splats
from splatwire.sequence import SequenceOptions, encode_sequence

PROTOCOL = """
[protocol]
name = "moving"
title = "moving"
metrics = ["psnr", "mae"]
views = 4
[[scene]]
name = "shell"
stream = "clip.swz"
reference = "frames"
[[loss]]
model = "bernoulli:0.5"
[[row]]
key = "whole"
label = "no loss"
conceal = "motion"
lossless = true
[[row]]
key = "drift"
label = "drift"
conceal = "drift"
options = { share = 0.5 }
[[row]]
key = "grow"
label = "grow"
conceal = "grow"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequences")
    install_page("your-own-concealer.md", folder / "site")
    (folder / "frames").mkdir()
    frames = moving_frames(150, 8)
    for number, splats in enumerate(frames):
        write_splats([splats], folder / "frames" / f"{number}.ply")
    write_stream(encode_sequence(frames, SequenceOptions(group_frames=4))[0], folder / "clip.swz")
    (folder / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_study_and_its_workers_score_temporal_concealers_of_packages(folder):
    done = run_with(folder / "site", folder, "study", "study.toml", "-o", "out", "--engine", "local", "--workers", "1")
    assert done.returncode == 0, done.stderr
    with (folder / "out" / "records.csv").open() as file:
        records = list(csv.DictReader(file))
    assert {record["conceal"] for record in records} == {"motion", "drift"}
    assert [r["view"] for r in records if r["conceal"] == "drift"] == ["frame_0", "frame_2", "frame_4", "frame_7"]
    means = {name: sum(float(r["psnr"]) for r in records if r["conceal"] == name) / 4 for name in ("motion", "drift")}
    assert means["motion"] > means["drift"] > 5
    assert "concealer 'grow' is for still scenes, and it is a sequence" in (folder / "out" / "tables.md").read_text()
    again = run_with(folder / "site", folder, "study", "study.toml", "-o", "out")
    assert "0 units computed" in again.stdout
