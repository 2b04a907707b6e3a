"""Protocols on causal scenes and on Gaussians skip rows of HAC++ packets and report that."""

from pathlib import Path

import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from scenes import tiny_cameras, tiny_causal_scene
from splatwire.anchors.scene_file import save_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.codec import encode_scene
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluation.study import InProcess, Store, load_study, measure_study_sizes, run_study, summarize
from splatwire.evaluation.study.sizes import size_tables
from splatwire.evaluation.study.tables import result_tables
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]

ROWS = """
[[row]]
key = "separated"
label = "as HAC++ packs"
preset = "hacpp"
conceal = "zero"

[[row]]
key = "raster"
label = "raster order"
order = "raster"

[[row]]
key = "grow"
label = "grow"
conceal = "grow"
block_size = 60
"""
NEVER = ROWS[: ROWS.index('[[row]]\nkey = "grow"')]


def silent(task: str, share: float) -> None:
    """Progress that shows no bar."""


def protocol(folder: Path, kind: str, rows: str, source: str) -> Path:
    head = f'[protocol]\nname = "made"\ntitle = "made"\nkind = "{kind}"\nseeds = [0]\nmetrics = ["psnr"]\n'
    loss = '[[loss]]\nmodel = "bernoulli:0.3"\n' if kind == "losses" else ""
    scene = f'[[scene]]\nname = "causal"\n{source}\ncameras = "cameras.json"\n'
    (folder / "protocol.toml").write_text(head + scene + loss + rows)
    return folder / "protocol.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("causal")
    scene = tiny_causal_scene(seed=5, num_anchors=180)
    save_scene(scene, folder / "tiny.scene")
    write_stream(encode_scene(scene, Packetization(block_size=60)), folder / "tiny.swz")
    means = Numbers(0).randn(180, 3)
    turns = unit(np.ones((180, 4), np.float32))
    splats = Splats(
        means,
        turns,
        np.full((180, 3), 0.1, np.float32),
        np.full((180,), 0.5, np.float32),
        np.zeros((180, 1, 3), np.float32),
    )
    write_stream(encode_scene(SplatScene(splats), Packetization(block_size=60)), folder / "explicit.swz")
    save_cameras(tiny_cameras(1, 48, 36), folder / "cameras.json")
    return folder


@pytest.mark.parametrize("source", ['stream = "tiny.swz"', 'scene = "tiny.scene"', 'stream = "explicit.swz"'])
def test_rows_of_unsupported_packets_are_skipped(folder: Path, tmp_path: Path, source: str):
    study = load_study(protocol(folder, "losses", ROWS, source))
    result = run_study(study, Store(tmp_path / "store"), InProcess(), silent)
    assert {record["label"] for record in result.merged()} == {"grow"}
    assert result.skipped == tuple(
        f"Row '{label}' did not run on causal: only anchors of HAC++ (format 1) can be packed so."
        for label in ("as HAC++ packs", "raster order")
    )


def test_size_table_marks_unavailable_columns(folder: Path, tmp_path: Path):
    study = load_study(protocol(folder, "sizes", ROWS, 'stream = "tiny.swz"'))
    (sizes,) = measure_study_sizes(study, Store(tmp_path / "store"), silent)
    assert list(sizes.columns) == ["grow"]
    assert sizes.columns["grow"]["networks"] > 0
    (table,) = size_tables(study, [sizes])
    assert "(not for this scene: as HAC++ packs, raster order)" in table.title


def test_concealers_of_sequences_are_skipped_on_still_scenes(folder: Path, tmp_path: Path):
    rows = UNFIT.replace("cari", "motion")
    result = run_study(
        load_study(protocol(folder, "losses", rows, 'stream = "explicit.swz"')), Store(tmp_path), InProcess(), silent
    )
    assert {record["label"] for record in result.merged()} == {"grow"}
    assert "concealer 'motion' is for sequences, and it is a still scene" in " ".join(result.skipped)


def test_scene_without_any_valid_row_is_refused(folder: Path, tmp_path: Path):
    study = load_study(protocol(folder, "losses", NEVER, 'stream = "tiny.swz"'))
    with pytest.raises(InvalidValueError, match="lacks what every row needs, or cannot be packed so"):
        run_study(study, Store(tmp_path / "store"), InProcess(), silent)


UNFIT = """
[[row]]
key = "sketch"
label = "no sketch here"
conceal = "sketch"
block_size = 60

[[row]]
key = "needs"
label = "needs a prior"
conceal = "cari"
block_size = 60

[[row]]
key = "grow"
label = "grow"
conceal = "grow"
block_size = 60
"""


@pytest.mark.parametrize("source", ["tiny.swz", "explicit.swz"])
def test_row_with_an_unsupported_concealer_is_skipped_with_a_reason(folder: Path, tmp_path: Path, source: str):
    study = load_study(protocol(folder, "losses", UNFIT, f'stream = "{source}"'))
    result = run_study(study, Store(tmp_path), InProcess(), silent)
    ran = {record["label"] for record in result.merged()}
    assert "grow" in ran
    assert "no sketch here" not in ran
    assert "reads the section 'sketch'" in " ".join(result.skipped)
    (table,) = result_tables(result, summarize(result))
    shown = {row[0]: row[1] for row in table.rows}
    assert {label for label, figure in shown.items() if figure == "did not run"} == set(shown) - ran
    assert len(table.rows) == 3
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_concealers_that_need_anchors_are_skipped_on_gaussians(folder: Path, tmp_path: Path):
    rows = UNFIT.replace("cari", "idw")
    result = run_study(
        load_study(protocol(folder, "losses", rows, 'stream = "explicit.swz"')), Store(tmp_path), InProcess(), silent
    )
    assert {record["label"] for record in result.merged()} == {"grow"}
    assert result.skipped_rows == {"causal": ("sketch", "needs")}
    assert "concealer 'idw' needs" in result.skipped[1]


def test_scene_without_any_valid_row_is_refused_before_the_work(folder: Path, tmp_path: Path):
    rows = UNFIT[: UNFIT.index('[[row]]\nkey = "grow"')].replace("cari", "idw")
    study = load_study(protocol(folder, "losses", rows, 'stream = "explicit.swz"'))
    with pytest.raises(InvalidValueError, match=r"no row can run on scene 'causal': concealer 'sketch'"):
        run_study(study, Store(tmp_path), InProcess(), silent)
