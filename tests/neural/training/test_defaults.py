"""Defaults of `splatwire train`, and initial points from files."""

import dataclasses
import io
import itertools
import json
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch
import tyro
from PIL import Image
from rich.console import Console
from rich.progress import Progress as Bars

from splatwire.cli._run_train import DEFAULT_ITERATIONS, _config, check_device
from splatwire.cli._training import columns, line, stopped_early, time_left
from splatwire.cli.main import main
from splatwire.cli.train import Train
from splatwire.data import Dataset
from splatwire.errors import BackendUnavailableError, InvalidValueError
from splatwire.io.formats import read_splats, write_splats
from splatwire.neural.training import Progress, create_config
from splatwire.neural.training.initial import initial_state, points_of
from splatwire.neural.training.progress import RunningMeans
from splatwire.neural.training.step import StepReport
from splatwire.types import SplatScene
from splatwire.types.background import BLACK, Background
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

_FAR = Progress(20_000, 30_000, 0.1234, 0.1234, 1_234_567, 123_450_000, 7200.0, 12.3)


def _splats(*opacities: float) -> Splats:
    count = len(opacities)
    means = np.random.default_rng(0).random((count, 3), np.float32) - np.float32(0.5)
    quats, scales = np.tile(np.float32([1, 0, 0, 0]), (count, 1)), np.full((count, 3), 0.05, np.float32)
    return Splats(means, quats, scales, np.float32(opacities), np.zeros((count, 1, 3), np.float32))


@pytest.mark.parametrize(
    ("file", "preset"),
    [("transforms.json", "mipnerf360"), ("transforms_train.json", "synthetic_nerf"), ("poses_enu.json", "bungeenerf"),
     ("sparse/0/images.bin", "mipnerf360")],
)  # fmt: skip
def test_training_preset_follows_the_dataset_layout(file: str, preset: str, tmp_path: Path) -> None:
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text("{}")
    config = _config(Train(str(tmp_path), "scene"))
    assert (config.preset, config.milestones.iterations) == (preset, DEFAULT_ITERATIONS)
    chosen = _config(Train(str(tmp_path), "scene", preset="deep_blending", iterations=300))
    assert (chosen.preset, chosen.milestones.iterations) == ("deep_blending", 300)


def _run(words: list[object]) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    return int(stopped.value.code or 0)


def test_note_of_a_stopped_training_names_options_that_continue_it(capsys: pytest.CaptureFixture[str]) -> None:
    for has_init, options in ((False, "--resume continues"), (True, "--resume in place of --init continues")):
        stopped_early(10, 20, has_init=has_init)
        assert f"the same command with {options}" in capsys.readouterr().err


def test_missing_data_selects_no_preset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for data in (tmp_path, tmp_path / "absent"):
        assert _run(["train", data, "-o", tmp_path / "out.scene"]) == 2
        stderr = capsys.readouterr().err
        assert str(data) in stderr
        assert "preset mip" not in stderr


@pytest.mark.parametrize(("option", "color"), [((), BLACK), (("--background", 1, 0.5, 0), (1.0, 0.5, 0.0))])
def test_background_option_has_the_common_syntax(option: tuple[object, ...], color: Background) -> None:
    words = [str(word) for word in ("data", "-o", "scene", *option)]
    verb = tyro.cli(Train, args=words, config=(tyro.conf.OmitArgPrefixes,))
    assert _config(verb).background == color
    with pytest.raises(InvalidValueError, match="background"):
        _config(dataclasses.replace(verb, background=(2.0, 0.0, 0.0)))


def test_progress_line_fits_into_80_columns() -> None:
    """A long line is truncated in favour of the counter."""
    output = io.StringIO()
    console = Console(file=output, width=80, force_terminal=True, color_system=None)
    bars = Bars(*columns(), console=console, expand=True, get_time=itertools.count(step=3).__next__)
    task = bars.add_task(f"{line(_FAR)}, test 27.31 dB", total=30_000, left=time_left(_FAR))
    for iteration in range(19_990, 20_001, 2):
        bars.update(task, completed=iteration)
    console.print(bars.get_renderable())
    assert "20000/30000" in output.getvalue()
    assert re.search(r"\d:\d\d:\d\d", output.getvalue())
    assert "loss 0.1234" in output.getvalue()


def test_time_left_excludes_compilation(dataset: Dataset) -> None:
    """Compilation may take place in several iterations; no estimate is shown before enough iterations have passed."""
    config = create_config("mipnerf360", iterations=2400)
    state, means = initial_state(dataset, config), RunningMeans(config.milestones.iterations)
    report = StepReport(torch.tensor(0.1), torch.tensor(0.1), None, num_sampled=0, num_drawn=torch.tensor(1))
    times = []
    for iteration, seconds in enumerate([40.0, 12.0, 9.0] + [0.1] * 30, 1):
        state.iteration = iteration
        times.append(time_left(means.update(state, report, seconds, 0.0)))
    assert times[0] == "-:--:--"
    assert set(times[9:]) <= {f"0:03:{second}" for second in range(50, 60)}


def test_chosen_preset_is_printed_and_recorded(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.scene"
    words = ["train", folder, "-o", output, "--iterations", 20, "--voxel-size", 0.2, "--json"]
    write_splats([_splats(*[0.5] * 40)], tmp_path / "start.ply")
    assert _run([*words, "--init", tmp_path / "start.ply"]) == 0
    captured = capsys.readouterr()
    assert "preset mipnerf360 (chosen by the data), 20 iterations" in captured.err
    result = json.loads(captured.out)
    assert result["recipe"]["preset"] == "mipnerf360"
    assert 0 < result["num_anchors"] <= 40 + 20  # the random box has 1,000 and more
    assert _run([*words, "--init", tmp_path / "start.ply", "--resume"]) == 2
    assert "--init" in capsys.readouterr().err


def test_initial_points_are_the_visible_gaussians(tmp_path: Path) -> None:
    splats = _splats(0.5, 0.001, 0.9)
    write_splats([splats], tmp_path / "a.ply")
    points = points_of(SplatScene(read_splats(tmp_path / "a.ply")))
    assert np.array_equal(points.positions, splats.means[[0, 2]])
    assert bool((points.colors == 0.5).all())
    write_splats([_splats(*[0.001] * 3)], tmp_path / "b.ply")
    with pytest.raises(InvalidValueError, match="transparent"):
        points_of(SplatScene(read_splats(tmp_path / "b.ply")))


def test_unusable_gpu_is_refused_with_the_missing_part(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_device("cpu") == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert check_device("auto") == "cpu"
    assert capsys.readouterr().err == ""
    with pytest.raises(BackendUnavailableError, match="no CUDA device"):
        check_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BackendUnavailableError, match=r"pip install 'splatwire\[gpu\]'"):
        check_device("cuda")
    assert check_device("auto") == "cpu"
    assert "training on the CPU: backend 'cuda' is not available: gsplat is missing" in capsys.readouterr().err
    monkeypatch.setattr("importlib.util.find_spec", lambda name: types.SimpleNamespace())
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(BackendUnavailableError, match="'gsplat'"):
        check_device("cuda")
    assert check_device("auto") == "cpu"


def test_gpu_with_working_gsplat_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: types.SimpleNamespace())
    monkeypatch.setattr("splatwire.cli._run_train.check_gsplat", lambda: drawn.append("one"))
    assert [check_device(name) for name in ("auto", "cuda", "cpu")] == ["cuda", "cuda", "cpu"]
    assert drawn == ["one", "one"]


BAD = {
    "a corrupt photo": (lambda root: (root / "images" / "view_03.png").write_bytes(b"\x89PNG no"), "view_03.png"),
    "a missing photo": (lambda root: (root / "images" / "view_03.png").unlink(), "view_03.png' is missing"),
    "a photo of another size": (
        lambda root: Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(root / "images" / "view_03.png"),
        "one size",
    ),
    "a pose that is not finite": (lambda root: _edit(root, lambda c: _poison(c)), "is not finite"),
    "a panorama": (lambda root: _edit(root, lambda c: c.update(camera_model="EQUIRECTANGULAR")), "EQUIRECTANGULAR"),
    "a lens of more terms": (lambda root: _edit(root, lambda c: c.update(k1=0.1, k4=0.1)), "undistort"),
    "a single view": (lambda root: _edit(root, lambda c: c.update(frames=c["frames"][:2])), "at least 2 views"),
    "no views": (lambda root: _edit(root, lambda c: c.update(frames=[])), "no views"),
}


def _edit(root: Path, change: object) -> None:
    content = json.loads((root / "transforms.json").read_text())
    change(content)  # type: ignore[operator]
    (root / "transforms.json").write_text(json.dumps(content))


def _poison(content: dict[str, list[dict[str, list[list[float]]]]]) -> None:
    content["frames"][3]["transform_matrix"][0][3] = float("nan")


@pytest.mark.parametrize("name", BAD)
def test_invalid_data_is_one_error_line_before_any_work(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage, message = BAD[name]
    damage(folder)
    output = tmp_path / "out.scene"
    assert _run(["train", folder, "-o", output, "--iterations", 20, "--voxel-size", 0.2]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("splatwire: error: ")]
    assert len(errors) == 1
    assert message in errors[0]
    assert not output.exists()


def test_full_disk_is_detected_before_training(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object, **more: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("splatwire.anchors.tensor_file.save_file", full)
    output = tmp_path / "out.scene"
    assert _run(["train", folder, "-o", output, "--iterations", 20, "--voxel-size", 0.2]) == 2
    assert "No space left" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene"]
