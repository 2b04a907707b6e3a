import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splat_io.formats.test_origin import UTM
from splatwire.anchors.scene_file import load_scene, save_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import Dataset
from splatwire.errors import DatasetError, DivergedError, InvalidValueError
from splatwire.neural.training import (
    Listener,
    Progress,
    QualityReport,
    RunOptions,
    TrainResult,
    load_checkpoint,
    train_scene,
)
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.finetune import fine_tuning_config, state_of_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.quality import assess_scene
from splatwire.neural.training.step import TrainingStep
from splatwire.types.scene_digest import scene_digest

pytestmark = pytest.mark.slow


def _longer(config: TrainConfig) -> TrainConfig:
    growth = dataclasses.replace(config.growth, gradient_threshold=2e-4)
    return dataclasses.replace(config, milestones=config.milestones.scaled(200), growth=growth)


@pytest.fixture(scope="module")
def trained(dataset: Dataset, config: TrainConfig) -> tuple[float, list[Progress], list[QualityReport], Dataset]:
    """A complete run on all views except two, with the PSNR before it."""
    train, test = dataset.select([0, 1, 2, 4, 5, 6]), dataset.select([3, 7])
    config = _longer(config)
    news: list[Progress] = []
    reports: list[QualityReport] = []
    state = initial_state(train, config)
    before = assess_scene(export_scene(state, config), train, 6, 0).psnr
    options = RunOptions(test_interval=100)
    result = train_scene(
        train, test, config, state=state, options=options, listener=Listener(news.append, reports.append)
    )
    after = assess_scene(result.scene, train, 6, 200).psnr
    reports.append(dataclasses.replace(reports[-1], psnr=after))
    return before, news, reports, train


@pytest.fixture(scope="module")
def straight(dataset: Dataset, config: TrainConfig) -> TrainResult:
    """An uninterrupted run on all views, without callbacks."""
    return train_scene(dataset, None, config)


def test_training_improves_pictures(
    trained: tuple[float, list[Progress], list[QualityReport], Dataset],
) -> None:
    before, news, reports, _ = trained
    assert [report.iteration for report in reports] == [100, 200, 200]
    assert reports[-1].psnr > before + 3
    assert news[-1].l1 < 0.7 * news[5].l1
    assert len(news) == 200


def test_progress_reports_size_once_the_context_is_trained(
    trained: tuple[float, list[Progress], list[QualityReport], Dataset], config: TrainConfig
) -> None:
    _, news, _, _ = trained
    start = _longer(config).milestones.context_start
    sizes = [now.estimated_bytes for now in news]
    assert all(size is None for size in sizes[:start])
    assert all(size is not None and size > 0 for size in sizes[start:])


def test_trained_scene_round_trips_through_file_and_codec(
    dataset: Dataset, straight: TrainResult, tmp_path: Path
) -> None:
    assert straight.test is None
    save_scene(straight.scene, tmp_path / "scene.splat")
    scene = load_scene(tmp_path / "scene.splat")
    assert np.array_equal(scene.anchors.features, straight.scene.anchors.features)
    decoded = decode_stream(encode_scene(scene)).scene
    assert decoded.anchors.num_anchors == scene.anchors.num_anchors
    kept = assess_scene(decoded, dataset, 8, 0).psnr
    assert kept > assess_scene(scene, dataset, 8, 0).psnr - 1.0


def test_stopped_run_leaves_a_resumable_checkpoint(
    dataset: Dataset, config: TrainConfig, straight: TrainResult, tmp_path: Path
) -> None:
    path, seen = tmp_path / "run.checkpoint", []
    listener = Listener(progress=seen.append, should_stop=lambda: len(seen) == 10)
    stopped = train_scene(dataset, None, config, options=RunOptions(checkpoint=path), listener=listener)
    assert stopped.stopped
    state, recipe = load_checkpoint(path)
    assert state.iteration == 10
    resumed = train_scene(dataset, None, recipe, state=state)
    assert not resumed.stopped
    assert np.array_equal(resumed.scene.anchors.features, straight.scene.anchors.features)
    with pytest.raises(DatasetError, match="more training views"):
        train_scene(dataset.select([0, 1]), None, recipe, state=load_checkpoint(path)[0])


def test_preview_callbacks_do_not_change_the_result(
    dataset: Dataset, config: TrainConfig, straight: TrainResult, tmp_path: Path
) -> None:
    options = RunOptions(tmp_path / "run.checkpoint", checkpoint_interval=7, test_interval=9)
    watched = train_scene(dataset, dataset.select([2]), config, options=options)
    assert np.array_equal(straight.scene.anchors.features, watched.scene.anchors.features)
    assert watched.test is not None


def test_diverging_run_is_reported(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)
    with torch.no_grad():
        state.parameters["heads.color.output.bias"].fill_(torch.nan)
    with pytest.raises(DivergedError, match="iteration 1: the loss is not finite") as caught:
        train_scene(dataset, None, config, state=state)
    assert caught.value.iteration == 1


@pytest.mark.parametrize("part", ["parameters.features", "second.features", "statistics.gradient_sum", "steering"])
def test_a_diverged_run_that_is_stopped_keeps_the_checkpoint_before(
    dataset: Dataset, config: TrainConfig, tmp_path: Path, part: str
) -> None:
    path, state, seen = tmp_path / "run.checkpoint", initial_state(dataset, config), list[Progress]()

    def stop() -> bool:
        if len(seen) < 6:
            return False
        if part == "steering":
            state.size_controller = dataclasses.replace(state.size_controller, log_error=math.inf)
            return True
        parts = {
            "parameters.features": state.parameters["features"],
            "second.features": state.moments["features"].second,
            "statistics.gradient_sum": state.statistics.gradient_sum,
        }
        with torch.no_grad():
            parts[part][0] = torch.nan
        return True

    listener = Listener(progress=seen.append, should_stop=stop)
    with pytest.raises(DivergedError, match=f"iteration 6: '.*{part.split('.')[-1]}' is not finite"):
        train_scene(
            dataset, None, config, state=state, options=RunOptions(path, checkpoint_interval=5), listener=listener
        )
    assert load_checkpoint(path)[0].iteration == 5


def test_a_run_without_checkpoints_exports_no_scene_that_is_not_finite(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)

    def stop() -> bool:
        with torch.no_grad():
            state.parameters["features"][0] = torch.nan
        return True

    with pytest.raises(DivergedError, match="iteration 1: 'features' is not finite"):
        train_scene(dataset, None, config, state=state, listener=Listener(should_stop=stop))


def test_damaged_photo_is_detected_before_training(dataset: Dataset, config: TrainConfig, tmp_path: Path) -> None:
    broken = tmp_path / "broken.png"
    broken.write_bytes(dataset.image_paths[5].read_bytes()[:-200])
    paths = (*dataset.image_paths[:5], broken, *dataset.image_paths[6:])
    calls: list[Progress] = []
    with pytest.raises(DatasetError, match=r"broken\.png"):
        train_scene(
            dataclasses.replace(dataset, image_paths=paths), None, config, listener=Listener(progress=calls.append)
        )
    assert not calls


def test_empty_trained_scene_is_not_exported(dataset: Dataset, config: TrainConfig) -> None:
    state = initial_state(dataset, config)
    with torch.no_grad():
        state.parameters["mask_logits"].fill_(-9)
    with pytest.raises(InvalidValueError, match="no anchor"):
        export_scene(state, config)


def test_empty_view_leaves_the_heads_unchanged(dataset: Dataset, config: TrainConfig) -> None:
    from splatwire.neural.training.photometric_loss import prepare_photo

    state = initial_state(dataset, config)
    away = dataset.cameras.viewmats.copy()
    away[:, [0, 2]] *= -1
    cameras = dataclasses.replace(dataset.cameras, viewmats=away)
    before = {name: value.detach().clone() for name, value in state.parameters.items()}
    report = TrainingStep(config, cameras)(state, 0, prepare_photo(torch.from_numpy(dataset.image(0))))
    assert report.num_gaussians == 0
    assert all(torch.equal(before[name], value.detach()) for name, value in state.parameters.items())


def test_preview_shows_photo_and_render(dataset: Dataset, config: TrainConfig) -> None:
    scene = export_scene(initial_state(dataset, config), config)
    report = assess_scene(scene, dataset, 3, 0)
    assert report.num_views == 3
    height, width = dataset.cameras.height, dataset.cameras.width
    assert tuple(report.preview.shape) == (height, 2 * width, 3)
    photo = np.asarray(Image.open(dataset.image_paths[0]), dtype=np.float32) / 255
    assert np.abs(report.preview[:, :width] - photo).max() < 1e-6


def test_a_geo_referenced_training_equals_a_local_one(
    dataset: Dataset, config: TrainConfig, straight: TrainResult, tmp_path: Path
) -> None:
    assert dataset.points is not None
    cameras = dataclasses.replace(dataset.cameras, origin=UTM)
    points = dataclasses.replace(dataset.points, origin=UTM)
    there = dataclasses.replace(dataset, cameras=cameras, points=points)
    interval = config.milestones.iterations // 2 + 1
    result = train_scene(there, there, config, options=RunOptions(tmp_path / "a.checkpoint", interval))
    assert result.scene.origin == result.state.origin == UTM
    assert scene_digest(result.scene.anchors) == scene_digest(straight.scene.anchors)
    assert result.test is not None
    expected = assess_scene(export_scene(straight.state, config), dataset, dataset.num_views, 0).psnr
    assert result.test.psnr == pytest.approx(expected, abs=1e-3)
    state, config = load_checkpoint(tmp_path / "a.checkpoint")
    assert state.origin == UTM
    moved = dataclasses.replace(there, cameras=cameras.relative_to((UTM[0] + 2, UTM[1], UTM[2] - 1)))
    resumed = train_scene(moved, None, config, state=state)
    assert resumed.scene.origin == UTM
    assert assess_scene(resumed.scene, moved, 4, 0).psnr == pytest.approx(result.test.psnr, abs=0.3)


def test_fine_tuning_keeps_the_origin_of_the_scene(
    dataset: Dataset, config: TrainConfig, straight: TrainResult
) -> None:
    scene = dataclasses.replace(straight.scene, origin=UTM)
    cameras = dataclasses.replace(dataset.cameras, origin=UTM).relative_to((UTM[0] + 2, UTM[1], UTM[2] - 1))
    there = dataclasses.replace(dataset, cameras=cameras, points=None)
    short = fine_tuning_config(dataclasses.replace(config, milestones=config.milestones.scaled(4)), scene)
    result = train_scene(there, None, short, state=state_of_scene(scene, there, short))
    assert result.scene.origin == UTM
    before = assess_scene(straight.scene, dataset, 4, 0).psnr
    assert assess_scene(result.scene, there, 4, 0).psnr > before - 1
