import json
import re

from splatwire.cli import _fresh
from splatwire.codec import decode_stream
from splatwire.conceal import concealer_names

ROWS = ["no loss", "contiguous drop", "drop", "prior", "idw", "cari", "grow"]


def test_the_bundled_scene_shows_what_concealment_is_worth(run, tmp_path, monkeypatch, pytestconfig):
    calls = []
    monkeypatch.setattr(_fresh, "decode_in_fresh_process", lambda s: calls.append(s) or decode_stream(s))
    outcome = run("demo", "-o", tmp_path)
    assert outcome.status == 0
    assert "= reference" in outcome.out
    assert str(tmp_path / "report.html") in outcome.out.replace("\n", "")
    assert len(calls) == 1  # the stream that all concealers share was decoded elsewhere
    content, other = (json.loads((tmp_path / name / "results.json").read_text()) for name in ("", "explicit"))
    explicit = {row["method"]: row for row in other["rows"]}
    assert list(explicit) == ["no loss", "drop", "grow", "scene_free"]
    assert explicit["no loss"]["exact"]
    assert explicit["drop"]["num_bytes"] <= 430_000
    assert max(explicit[name]["psnr"] for name in ("grow", "scene_free")) > explicit["drop"]["psnr"]
    assert "snowmiku_gaussians" in (tmp_path / "explicit" / "report.html").read_text()
    rows = {row["method"]: row for row in content["rows"]}
    assert list(rows)[:7] == ROWS
    assert set(concealer_names()) - {"coarse"} <= set(rows)  # it needs levels
    assert rows["no loss"]["exact"]
    assert rows["no loss"]["psnr"] is None
    assert rows["no loss"]["ssim"] == 1
    assert rows["drop"]["num_lost"] == rows["grow"]["num_lost"] > 0
    assert all(row["lpips"] is None for row in rows.values()) == (content["lpips"] == "weights absent")
    assert (tmp_path / "report.html").stat().st_size > 20_000
    lossy = [row["psnr"] for name, row in rows.items() if name != "no loss"]
    assert max(lossy) >= rows["drop"]["psnr"] + 0.5
    assert rows["drop"]["psnr"] >= rows["contiguous drop"]["psnr"] + 1
    assert rows["drop"]["num_bytes"] <= 6_000_000
    assert {"kriging", "scene_free", "sketch"} <= set(rows)
    assert "gnn" not in rows
    page = (tmp_path / "report.html").read_text()
    assert 'class="lead"' in page
    assert "data-slider" in page
    assert "Quality over loss" in page
    assert page.index("<td>sketch</td>") < page.index("do worse than leaving") < page.index("<td>kriging</td>")
    assert 'href="explicit/report.html"' in page
    readme = (pytestconfig.rootpath / "README.md").read_text()
    for name in ("contiguous drop", "drop", "scene_free", "sketch"):
        line = re.search(rf"^\|[^|]*`{name}`[^|]*\| ([0-9.]+) \| ([0-9,]+) \|$", readme, re.M)
        assert abs(float(line[1]) - rows[name]["psnr"]) < 0.02, name
        assert line[2] == f"{rows[name]['num_bytes']:,}"
    assert rows["sketch"]["num_bytes"] > rows["drop"]["num_bytes"] == rows["scene_free"]["num_bytes"]
