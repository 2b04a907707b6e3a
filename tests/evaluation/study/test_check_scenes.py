"""Scenes that cannot be used are refused before the work, and only those."""

import dataclasses

import numpy as np
import pytest

from evaluation.masked_photos import write_photos
from explicit import ball_of_gaussians
from moving_sequences import moving_frames
from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import save_partial
from splatwire.bitstream import PRESETS, read_stream, write_stream
from splatwire.channel import transmit
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.errors import SplatwireError
from splatwire.evaluation.study import InProcess, SceneEntry, Store, Study, measure_study_sizes, run_study
from splatwire.evaluation.study.definition import Decoded, Loss, Row
from splatwire.evaluation.study.inputs import check_scenes
from splatwire.evaluation.study.sizes import size_tables
from splatwire.io import save_scene
from splatwire.io.formats import write_splats
from splatwire.sequence import encode_sequence

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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"source": "cut.ply", "kind": "scene"}, r"cut\.ply"),
        ({"source": "model", "kind": "model"}, r"checkpoint\.pth"),
        ({"reference": "notes.txt"}, r"notes\.txt"),
        ({"weights": "notes.txt"}, r"notes\.txt"),
    ],
    ids=["scene file", "model", "reference", "weights"],
)
@pytest.mark.needs_torch
def test_files_that_cannot_be_used_are_refused_before_the_work(study, tmp_path, change, message):
    """The first scene is good; nothing is encoded or drawn for it."""
    save_scene(ball_of_gaussians(), tmp_path / "whole.ply")
    (tmp_path / "cut.ply").write_bytes((tmp_path / "whole.ply").read_bytes()[:-1000])
    (tmp_path / "notes.txt").write_text("no scene")
    for iteration, names in ((1, ("point_cloud.ply", "checkpoint.pth")), (2, ("point_cloud.ply",))):
        folder = tmp_path / "model" / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).write_bytes(b"")
    changed = {name: tmp_path / value if name != "kind" else value for name, value in change.items()}
    bad = dataclasses.replace(study.scenes[0], name="other", **changed)
    rows = (COMPLETE, Row("gnn", "gnn", PRESETS["paper"], "gnn:{weights}"))
    steps = []
    with pytest.raises(SplatwireError, match=message):
        run_study(
            dataclasses.replace(study, scenes=(study.scenes[0], bad), rows=rows), Store(tmp_path / "store"),
            InProcess(), lambda *step: steps.append(step),
        )  # fmt: skip
    assert not steps


def test_results_of_other_codecs_that_are_no_scenes_are_refused_before_the_work(study, tmp_path):
    (tmp_path / "notes.txt").write_text("no scene")
    row = Row("x", "x", None, lossless=True, decoded=(Decoded("made up", tmp_path / "notes.txt"),))
    with pytest.raises(SplatwireError, match=r"notes\.txt"):
        check_scenes(dataclasses.replace(study, rows=(COMPLETE, row)), Store(tmp_path / "store"))


def test_a_scene_file_with_losses_is_refused_if_a_row_packs_it(study, lossy, tmp_path):
    save_partial(decode_stream(read_stream(lossy)[0]), tmp_path / "gaps.scene")
    entry = dataclasses.replace(study.scenes[0], source=tmp_path / "gaps.scene", kind="scene")
    packed = Row("packed", "packed", PRESETS["paper"])
    check_scenes(dataclasses.replace(study, scenes=(entry,)), Store(tmp_path / "store"), views=False)
    with pytest.raises(SplatwireError, match=r"gaps\.scene"):
        check_scenes(dataclasses.replace(study, scenes=(entry,), rows=(COMPLETE, packed)), Store(tmp_path / "store"))


def test_a_row_without_packetization_keeps_its_sections(study, tmp_path):
    tiers = np.arange(180) % 2
    stream = encode_scene(tiny_scene(seed=5, num_anchors=180), PRESETS["paper"], tiers=tiers)
    write_stream(with_section(stream, "more", b"content"), tmp_path / "tiers.swz")
    entry = dataclasses.replace(study.scenes[0], source=tmp_path / "tiers.swz")
    rows = (COMPLETE, Row("more", "more", None, sections=("more",)))
    result = run_study(
        dataclasses.replace(study, scenes=(entry,), rows=rows), Store(tmp_path / "store"), InProcess(), silent
    )
    assert {record["row"] for record in result.merged()} == {"complete", "more"}


def test_sizes_of_a_row_whose_sections_cannot_be_kept_are_left_out_with_a_warning(study, tmp_path, caplog):
    stream = encode_scene(tiny_scene(seed=5, num_anchors=180), PRESETS["paper"], tiers=np.arange(180) % 2)
    write_stream(with_section(stream, "more", b"content"), tmp_path / "tiers.swz")
    entry = dataclasses.replace(study.scenes[0], source=tmp_path / "tiers.swz")
    rows = (COMPLETE, Row("more", "more", PRESETS["paper"], sections=("more",)))
    measure_study_sizes(dataclasses.replace(study, scenes=(entry,), rows=rows), Store(tmp_path / "store"), silent)
    assert "row 'more' is left out" in caplog.text


def test_sizes_of_explicit_gaussians_are_not_those_of_anchors(study, tmp_path):
    save_scene(ball_of_gaussians(), tmp_path / "ball.ply")
    entry = dataclasses.replace(study.scenes[0], source=tmp_path / "ball.ply", kind="scene")
    rows = (Row("paper", "paper", PRESETS["paper"]),)
    study = dataclasses.replace(study, scenes=(entry,), rows=rows, kind="sizes")
    sizes = measure_study_sizes(study, Store(tmp_path / "store"), silent)
    assert size_tables(study, sizes)[0].title == "made up: bytes of 200 Gaussians"


def test_a_row_whose_sections_cannot_be_kept_is_skipped_with_a_reason(study, tmp_path):
    """A stream with tiers cannot be put into other packets with its sections."""
    tiers = np.arange(180) % 2
    stream = encode_scene(tiny_scene(seed=5, num_anchors=180), PRESETS["paper"], tiers=tiers)
    write_stream(with_section(stream, "more", b"content"), tmp_path / "tiers.swz")
    entry = dataclasses.replace(study.scenes[0], source=tmp_path / "tiers.swz")
    rows = (COMPLETE, Row("more", "more", PRESETS["paper"], sections=("more",)))
    result = run_study(
        dataclasses.replace(study, scenes=(entry,), rows=rows), Store(tmp_path / "store"), InProcess(), silent
    )
    assert {record["row"] for record in result.merged()} == {"complete"}
    assert "its sections cannot be kept in other packets" in " ".join(result.skipped)


def test_photos_of_a_sequence_are_refused(study, tmp_path):
    """Frames would be drawn by the cameras of the photos, with which they have nothing in common."""
    (tmp_path / "frames").mkdir()
    frames = moving_frames(40, 2)
    for number, splats in enumerate(frames):
        write_splats([splats], tmp_path / "frames" / f"{number}.ply")
    write_stream(encode_sequence(frames)[0], tmp_path / "clip.swz")
    clip = with_views(
        study, source=tmp_path / "clip.swz", reference=tmp_path / "frames", cameras=None, photos=tmp_path / "photos"
    )
    with pytest.raises(SplatwireError, match="is a sequence"):
        check_scenes(clip, Store(tmp_path / "store"))
