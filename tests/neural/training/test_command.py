"""The verb `train` on photos in the nerfstudio layout."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from splatwire.anchors.scene_file import load_scene
from splatwire.cli.main import main
from splatwire.codec import encode_scene
from splatwire.data import Dataset
from splatwire.neural.training import load_checkpoint

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def folder(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset as files."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "images").mkdir()
    frames = []
    for view, path in enumerate(dataset.image_paths):
        shutil.copy(path, folder / "images" / path.name)
        pose = np.linalg.inv(dataset.cameras.viewmats[view]) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/{path.name}", "transform_matrix": pose.tolist()})
    K = dataset.cameras.Ks[0]
    intrinsics = {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), "w": 48, "h": 32}
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    return folder


def _words(folder: Path, output: Path, *more: object) -> list[str]:
    words = ["train", folder, "-o", output, "--iterations", 20, "--voxel-size", 0.2, *more]
    return [str(word) for word in words]


def _run(words: list[str]) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    return int(stopped.value.code or 0)


def test_train_command_runs_briefly(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, preview = tmp_path / "trained.scene", tmp_path / "preview.png"
    assert _run(_words(folder, output, "--json", "--preview", preview)) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["iterations"] == 20
    assert result["test_psnr"] > 5
    assert result["recipe"]["milestones"]["iterations"] == 20
    scene = load_scene(output)
    assert scene.anchors.num_anchors == result["num_anchors"]
    assert encode_scene(scene).num_bytes > 0
    assert preview.stat().st_size > 0
    assert load_checkpoint(output.with_name("trained.scene.checkpoint"))[0].iteration == 20
    assert _run(_words(folder, output, "--resume", "--json")) == 0  # no iterations are left, which is no error
    assert json.loads(capsys.readouterr().out)["test_psnr"] == result["test_psnr"]
    assert _run(_words(folder, output, "--resume", "--seed", 3, "--loss", "bernoulli:0.2")) == 2
    assert "--loss, --seed: the checkpoint was made with another value" in capsys.readouterr().err


def test_resuming_with_photos_of_another_size_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "trained.scene"
    assert _run(_words(folder, output)) == 0
    width = load_checkpoint(tmp_path / "trained.scene.checkpoint")[0].photo_size[0]
    capsys.readouterr()
    assert _run(_words(folder, output, "--resume", "--max-width", width // 2)) == 2
    assert f"the checkpoint was made with photos of {width} x " in capsys.readouterr().err


def test_the_first_ctrl_c_leaves_a_checkpoint(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "trained.scene"
    words = _words(folder, output)
    words[words.index("--iterations") + 1] = "1000000"
    checkpoint = tmp_path / "trained.scene.checkpoint"
    process = subprocess.Popen([sys.executable, "-m", "splatwire", *words], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 600
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130, errors
    assert "--resume" in errors
    assert not output.exists()
    state, config = load_checkpoint(checkpoint)
    assert 0 < state.iteration < config.milestones.iterations


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--preset", "mip"), "mipnerf360"),
        (("--device", "tpu"), "cuda"),
        (("--device", "cuda"), "CPU"),
        (("--lmbda", "-1"), "lambda"),
        (("--size", "half a MB"), "500kB"),
        (("--resume",), "no such file"),
        (("--checkpoint-interval", "0"), "checkpoint-interval"),
    ],
)
def test_invalid_options_are_one_error_line(
    more: tuple[str, ...], message: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(_words(folder, tmp_path / "trained.scene", *more)) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_folder_without_a_dataset_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run(_words(tmp_path / "nothing", tmp_path / "trained.scene")) == 2
    assert "nothing" in capsys.readouterr().err


@pytest.mark.parametrize("photo", [0, 3])  # the first is a test view, which is checked before the work as well
def test_damaged_photo_is_reported_before_the_first_iteration(
    photo: int, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*words: object) -> None:
        raise AssertionError("an iteration began")

    monkeypatch.setattr("splatwire.neural.training.step.TrainingStep.__call__", never)
    shutil.copytree(folder, tmp_path / "data")
    damaged = sorted((tmp_path / "data" / "images").iterdir())[photo]
    damaged.write_bytes(damaged.read_bytes()[:-300])
    assert _run(_words(tmp_path / "data", tmp_path / "trained.scene")) == 2
    assert f"{damaged}: the image is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("-o", "."), "is a folder: name a file"),
        (("-o", "/dev/null"), "no ordinary file"),
        (("-o", "notes/trained.scene"), "notes: not a folder"),
        (("--preview", "a.xyz"), "--preview must end in .png"),
        (("--preview", "notes/a.png"), "notes: not a folder"),
    ],
)
def test_unwritable_output_is_reported_at_once(
    more: tuple[str, ...], message: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes").write_text("hello")
    assert _run(_words(folder, tmp_path / "trained.scene", *more)) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["notes"]


def test_single_photo_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(folder, tmp_path / "data")
    content = json.loads((folder / "transforms.json").read_text())
    for count, message in ((1, "too few in all"), (2, "images: training needs at least 2 views, and there is 1")):
        kept = json.dumps({**content, "frames": content["frames"][:count]})
        (tmp_path / "data" / "transforms.json").write_text(kept)
        assert _run(_words(tmp_path / "data", tmp_path / "trained.scene")) == 2
        assert message in capsys.readouterr().err
