import json
import re
import subprocess
import sys
from importlib.util import find_spec

import pytest

from splatwire.cli import _processes, _subprocess
from splatwire.codec import decode_stream
from splatwire.concealment import concealer_names
from splatwire.types import Anchors, Prior
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

ROWS = ["no loss", "contiguous drop", "drop", "prior", "idw", "cari", "grow"]


def test_demo_shows_the_gain_of_concealment_on_the_bundled_scene(run, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(_subprocess, "decode_in_fresh_process", lambda s: calls.append(s) or decode_stream(s))
    tmp_path = tmp_path / "made by the demo"
    outcome = run("demo", "-o", tmp_path, "--views", 1)
    assert outcome.status == 0, outcome.err
    assert "= reference" in outcome.out
    assert str(tmp_path / "report.html") in outcome.out.replace("\n", "")
    assert len(calls) == 1  # the shared stream is decoded before the concealers run
    content, other = (json.loads((tmp_path / name / "results.json").read_text()) for name in ("", "explicit"))
    explicit = {row["method"]: row for row in other["rows"]}
    assert set(explicit) == {"no loss", *concealer_names((), {Splats})}
    assert explicit["no loss"]["exact"]
    assert explicit["drop"]["num_bytes"] <= 430_000
    assert max(explicit[name]["psnr"] for name in ("grow", "scene_free")) > explicit["drop"]["psnr"]
    assert "snowmiku_gaussians" in (tmp_path / "explicit" / "report.html").read_text()
    rows = {row["method"]: row for row in content["rows"]}
    with_torch = find_spec("torch") is not None
    assert list(rows)[:7] == ROWS if with_torch else not {"prior", "cari", "kriging"} & set(rows)
    assert set(concealer_names((), {Anchors, Prior})) <= set(rows)
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
    assert {"kriging", "scene_free", "sketch"} - (set() if with_torch else {"kriging"}) <= set(rows)
    assert "gnn" not in rows
    page = (tmp_path / "report.html").read_text()
    assert 'class="lead"' in page
    assert "data-slider" in page
    assert "Quality over loss" in page
    if with_torch:
        assert page.index("<td>sketch</td>") < page.index("do worse than drop") < page.index("<td>kriging</td>")
    assert 'href="explicit/report.html"' in page
    assert rows["sketch"]["num_bytes"] > rows["drop"]["num_bytes"] == rows["scene_free"]["num_bytes"]


def test_a_process_that_is_no_longer_needed_can_remove_its_temporary_files(tmp_path, monkeypatch):
    """SIGKILL would leave them, when Ctrl-C or an error ends the demo."""
    monkeypatch.setattr(_processes, "GRACE_S", 240.0)
    code = (
        "import pathlib, signal, sys\n"
        "signal.signal(signal.SIGTERM, lambda *_: (pathlib.Path(sys.argv[1]).unlink(), sys.exit(3)))\n"
        "print(pathlib.Path(sys.argv[1]).touch(), flush=True)\nsignal.pause()"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "temporary")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        _processes.end_process(process)
    assert process.returncode == 3
    assert not list(tmp_path.iterdir())


@pytest.mark.extended
def test_the_readme_has_the_figures_of_the_demo(run, tmp_path, pytestconfig):
    assert run("demo", "-o", tmp_path).status == 0
    rows = {row["method"]: row for row in json.loads((tmp_path / "results.json").read_text())["rows"]}
    readme = (pytestconfig.rootpath / "README.md").read_text()
    for name in ("contiguous drop", "drop", "scene_free", "sketch"):
        line = re.search(rf"^\|[^|]*`{name}`[^|]*\| ([0-9.]+) \| ([0-9,]+) \|$", readme, re.M)
        assert abs(float(line[1]) - rows[name]["psnr"]) < 0.02, name
        assert line[2] == f"{rows[name]['num_bytes']:,}"
