"""Protocol files: their content, and one error before any work for each mistake."""

from pathlib import Path

import pytest

from splatwire.bitstream import PRESETS
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.evaluation.study import load_study
from splatwire.evaluation.study.definition import Loss
from splatwire.metrics.registry import PUBLISHED_LPIPS

pytestmark = pytest.mark.needs_torch

SHIPPED = sorted((Path(__file__).parents[3] / "benchmarks" / "paper").glob("*.toml"))


def test_protocol_equals_its_file(tiny_folder):
    study = load_study(tiny_folder / "protocol.toml")
    assert study.seeds == (0, 3)
    assert [row.key for row in study.rows] == ["reference", "contiguous", "drop", "idw"]
    assert study.row("contiguous").packetization.grouping == "contiguous"
    assert study.row("drop").packetization.lanes == PRESETS["paper"].lanes
    assert study.losses == (Loss("bernoulli:0.3"),)
    assert study.published[1].values == {"psnr": 22.5}
    assert study.scenes[0].source == tiny_folder / "tiny.swz"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("conceal =", "conseal =", "did you mean 'conceal'"),
        ('conceal = "idw"', 'conceal = "magic"', "magic"),
        ("seeds = [0, 3]", "seeds = [0, 3, 0]", "seed 0 is there 2 times"),
        ("seeds = [0, 3]", "seeds = [-1]", "seeds must be"),
        ("seeds = [0, 3]", "seeds = [0.5]", "an integer"),
        ('baseline = "drop"', 'baseline = "dorp"', "dorp"),
        ('key = "idw"', 'key = "drop"', "row drop is there 2 times"),
        ('label = "IDW"', 'label = "none"', "row label none"),
        ('grouping = "contiguous"', 'preset = "papre"', "did you mean 'paper'"),
        ('grouping = "contiguous"', 'grouping = "spiral"', "spiral"),
        ('conceal = "idw"', 'conceal = "idw"\nerode = "colour"', "colour"),
        ('conceal = "idw"', 'conceal = "idw"\noptions = {neighbors = "many"}', "row"),
        ("bernoulli:0.3", "bernoulli:3", "loss rate"),
        ("bernoulli:0.3", "poisson:3", "poisson"),
        ('model = "bernoulli:0.3"', 'model = "bernoulli:0.3"\nunit = "packet"', "loss unit"),
        ('metrics = ["psnr", "ssim"]', 'metrics = ["vmaf"]', "vmaf"),
        ('row = "idw"', 'row = "odw"', "odw"),
        ("psnr = 22.5", "pnsr = 22.5", "did you mean 'psnr'"),
        ("psnr = 22.5", 'psnr = "22.5"', "a number"),
        ("psnr = 22.5", "", "has no figure"),
        ('name = "made up"', 'name = "made up"\nmodel = "x"', "stream and model"),
        ('name = "tiny"', "views = 0", "views must be at least 1"),
        ("[protocol]", "[protocol", "not valid TOML"),
        ("[[loss]]", "[[losses]]", "did you mean 'loss'"),
        ("[[loss]]", "[loss]", "loss has single brackets: write [[loss]]"),
        ('conceal = "idw"', "[row.decoded]", "decoded has single brackets: write [[row.decoded]]"),
        ('conceal = "idw"\n', "", "rows 'drop' and 'idw' have the same settings"),
        ("seeds = [0, 3]", "seeds = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("seeds = [0, 3]", "seeds = " + "{a=" * 5000 + "1" + "}" * 5000, "nested too deeply"),
        ('conceal = "idw"', 'conceal = "idw"\noptions.' + ".".join("a" * 5000) + " = 1", "nested too deeply"),
        ("seeds = [0, 3]", "seeds = [" + "9" * 5000 + "]", "not valid TOML"),
        ("seeds = [0, 3]", f"seeds = [{2**63}]", "protocol seeds 1 is beyond the range"),
        ("psnr = 22.5", "psnr = " + "9" * 400, "psnr is beyond the range"),
        ("psnr = 22.5", "psnr = 1e999", "psnr must be a finite number"),
        ("psnr = 22.5", "psnr = nan", "psnr must be a finite number"),
        ('conceal = "idw"', 'conceal = "idw"\noptions = {power = nan}', "options power must be a finite number"),
        ('conceal = "idw"', 'conceal = "idw"\noptions = {power = 2024-01-01}', "not the date 2024-01-01"),
        ('conceal = "idw"', 'conceal = "idw"\noptions = {power = [07:32:00]}', "not the time 07:32:00"),
        ('name = "made up"', 'name = "made up"\nphotos = "~nosuchuser/photos"', "'~nosuchuser/photos' is no path"),
        ('name = "made up"', f'name = "made up"\nphotos = "{"x" * 5000}"', "is no path"),
        ('name = "tiny"', "picture_views = -1", "picture_views must be at least 0"),
    ],
)
def test_mistakes_are_reported_before_any_work(edited, old, new, words):
    with pytest.raises(InvalidValueError, match=r"edited\.toml") as caught:
        load_study(edited((old, new)))
    assert words in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_missing_scene_is_reported_with_its_path(edited):
    with pytest.raises(DatasetError, match=r"\[\[scene\]\] 1 \(made up\).*nowhere.*does not exist"):
        load_study(edited(('stream = "', 'stream = "nowhere')))


def test_missing_protocol_is_reported(tmp_path):
    with pytest.raises(DatasetError, match=r"absent\.toml"):
        load_study(tmp_path / "absent.toml")


def test_environment_variables_are_expanded(edited, tiny_folder, monkeypatch):
    path = edited((f'"{tiny_folder}/tiny.swz"', '"${SPLATWIRE_DATA}/tiny.swz"'))
    monkeypatch.delenv("SPLATWIRE_DATA", raising=False)
    with pytest.raises(InvalidValueError, match=r"made up\): the environment variable SPLATWIRE_DATA .* is not set"):
        load_study(path)
    monkeypatch.setenv("SPLATWIRE_DATA", str(tiny_folder))
    assert load_study(path).scenes[0].source == tiny_folder / "tiny.swz"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_protocols_are_valid_on_any_scene(path, tiny_folder):
    scene = load_study(tiny_folder / "protocol.toml").scenes[0]
    study = load_study(path, replaced=scene)
    assert study.name == path.stem
    assert study.kind == "sizes" or len(study.seeds) >= 5


def test_tables_of_the_paper_are_included():
    assert {"table1", "table2", "table3", "sizes", "bursts", "rates", "scene_scale"} <= {path.stem for path in SHIPPED}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_published_lpips_is_compared_with_the_same_variant(path, tiny_folder):
    """Publications of 3DGS codecs measure LPIPS of pictures in [0, 1], which `lpips` scales first."""
    study = load_study(path, replaced=load_study(tiny_folder / "protocol.toml").scenes[0])
    published = {metric for entry in study.published for metric in entry.values if "lpips" in metric}
    assert published <= {PUBLISHED_LPIPS} & set(study.metrics)
