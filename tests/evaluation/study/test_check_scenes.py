"""Scenes that cannot be used are refused before the work, and only those."""

import dataclasses

import pytest

from evaluation.masked_photos import write_photos
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import PRESETS, read_stream, write_stream
from splatwire.channel import transmit
from splatwire.errors import SplatwireError
from splatwire.evaluation.study import InProcess, SceneEntry, Store, Study, measure_study_sizes, run_study
from splatwire.evaluation.study.definition import Loss, Row
from splatwire.evaluation.study.inputs import check_scenes

COMPLETE = Row("complete", "no loss", None, lossless=True)


def silent(task, share):
    pass


@pytest.fixture
def study(tiny_folder):
    scene = SceneEntry("made up", tiny_folder / "tiny.swz", "stream", cameras=tiny_folder / "cameras.json")
    return Study("a", "a", (scene,), (COMPLETE,), (Loss("bernoulli:0.3"),), metrics=("psnr",))


@pytest.fixture
def lossy(tiny_folder, tmp_path):
    """Stream of which packets are missing."""
    stream, _ = read_stream(tiny_folder / "tiny.swz")
    write_stream(transmit(stream, "bernoulli:0.5", seed=1)[0], tmp_path / "lossy.swz")
    return tmp_path / "lossy.swz"


def with_views(study, **views):
    return dataclasses.replace(study, scenes=(dataclasses.replace(study.scenes[0], **views),))


def test_cameras_are_read_only_without_photos(study, tmp_path):
    (tmp_path / "cameras.json").write_text("[]")
    photos = write_photos(tmp_path / "photos", tiny_scene(num_anchors=60), tiny_cameras(9, 72, 64), 1)
    check_scenes(with_views(study, photos=photos, cameras=tmp_path / "cameras.json"), Store(tmp_path / "store"))
    with pytest.raises(SplatwireError, match=r"cameras\.json: has no views"):
        check_scenes(with_views(study, cameras=tmp_path / "cameras.json"), Store(tmp_path / "store"))


def test_photos_that_cannot_be_read_are_refused(study, tmp_path):
    (tmp_path / "photos").mkdir()
    with pytest.raises(SplatwireError, match="photos: not a dataset"):
        check_scenes(with_views(study, photos=tmp_path / "photos"), Store(tmp_path / "store"))


def test_an_incomplete_stream_is_scored_if_no_row_can_pack_it(study, lossy, tmp_path):
    whole = study.scenes[0].source
    entry = dataclasses.replace(study.scenes[0], source=lossy, reference=whole)
    absent = Row("absent", "needs a section", PRESETS["paper"], sections=("absent",))
    result = run_study(
        dataclasses.replace(study, scenes=(entry,), rows=(COMPLETE, absent)), Store(tmp_path / "store"), InProcess(),
        silent,
    )  # fmt: skip
    assert {record["row"] for record in result.merged()} == {"complete"}
    assert "it has no section 'absent'" in " ".join(result.skipped)
    packed = dataclasses.replace(study, scenes=(entry,), rows=(COMPLETE, Row("packed", "packed", PRESETS["paper"])))
    with pytest.raises(SplatwireError, match=r"lossy\.swz: \d+ of \d+ packets are missing, and rows put"):
        check_scenes(packed, Store(tmp_path / "store"))


def test_sizes_are_measured_only_if_every_stream_is_complete(study, lossy, tmp_path):
    """Cameras are not read, because nothing is drawn."""
    steps = []
    good = dataclasses.replace(study.scenes[0], cameras=tmp_path / "absent.json")
    sizes = dataclasses.replace(study, scenes=(good,), rows=(Row("paper", "paper", PRESETS["paper"]),), kind="sizes")
    check_scenes(sizes, Store(tmp_path / "store"), views=False)
    other = dataclasses.replace(good, name="other", source=lossy)
    with pytest.raises(SplatwireError, match="rows put the scene 'other'"):
        measure_study_sizes(
            dataclasses.replace(sizes, scenes=(good, other)),
            Store(tmp_path / "store"),
            lambda *step: steps.append(step),
        )
    assert not steps
    assert not list((tmp_path / "store").rglob("*.swz"))
