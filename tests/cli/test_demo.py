import json

from splatwire.cli import _fresh
from splatwire.codec import decode_stream
from splatwire.conceal import concealer_names

ROWS = ["no loss", "contiguous drop", "drop", "prior", "idw", "cari", "grow"]


def test_demo_makes_the_whole_journey(run, journey, tmp_path):
    words = ("--stream", journey / "tiny.swz", "--cameras", journey / "cameras.json", "-o", tmp_path / "demo")
    outcome = run("demo", *words, "--loss", "bernoulli:0.3", "--seed", 1, "--json")
    content = outcome.json
    rows = {row["method"]: row for row in content["rows"]}
    assert list(rows)[:7] == ROWS
    assert set(concealer_names()) <= set(rows)
    assert rows["no loss"]["psnr"] is None
    assert rows["no loss"]["exact"]
    assert rows["no loss"]["ssim"] == 1
    assert rows["drop"]["num_lost"] == rows["grow"]["num_lost"] > 0
    assert all(row["lpips"] is None for row in rows.values()) == (content["lpips"] == "weights absent")
    assert (tmp_path / "demo" / "report.html").stat().st_size > 20_000
    assert json.loads((tmp_path / "demo" / "results.json").read_text())["rows"] == content["rows"]


def test_demo_for_people(run, journey, tmp_path, monkeypatch):
    monkeypatch.setattr(_fresh, "decode_in_fresh_process", decode_stream)  # the other test has the real one
    words = ("--stream", journey / "tiny.swz", "--cameras", journey / "cameras.json", "-o", tmp_path / "demo")
    outcome = run("demo", *words, "--views", 1)
    assert outcome.status == 0
    assert "= reference" in outcome.out
    assert str(tmp_path / "demo" / "report.html") in outcome.out.replace("\n", "")
