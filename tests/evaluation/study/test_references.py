"""Reference pictures are rendered once and stored in one file each."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.data import save_cameras
from splatwire.errors import SplatwireError
from splatwire.evaluation.study import SceneEntry, Store, Study, concealment_rows
from splatwire.evaluation.study.definition import Loss
from splatwire.evaluation.study.references import prepare_references
from splatwire.render import render_scene
from splatwire.types.background import WHITE


def test_reference_renders_are_computed_once_and_yielded_singly(tmp_path):
    scene, cameras, calls = tiny_scene(num_anchors=60), tiny_cameras(3, 40, 32), []
    save_cameras(cameras, tmp_path / "cameras.json")
    entry = SceneEntry("a", tmp_path / "a.swz", "stream", cameras=tmp_path / "cameras.json")
    study = Study("a", "a", (entry,), concealment_rows(("drop",)), (Loss("none"),), views=2)

    def drawn():
        calls.append(1)
        return scene

    def prepare(background, stamp="x"):
        return prepare_references(study, entry, background, drawn, stamp, Store(tmp_path / "store"), lambda *_: None)

    images = render_scene(scene, cameras)
    first, again = prepare(scene.background), prepare(scene.background)
    assert (first, len(calls)) == (again, 1)
    views = first.open(tmp_path / "store")
    assert views.cameras.names == ("view_00", "view_02")
    assert np.array_equal(views.reference(0), images[0])
    assert np.array_equal(views.reference(1), images[2])
    assert len(list((tmp_path / "store" / first.renders).glob("*.npy"))) == 2
    assert prepare(WHITE).digest != first.digest == prepare(scene.background, "other").digest
    assert len(calls) == 3
    save_cameras(replace(cameras, near_depth=0.25), tmp_path / "cameras.json")
    assert prepare(scene.background).digest != first.digest
    assert len(calls) == 4
    save_cameras(cameras, tmp_path / "cameras.json")
    assert prepare(scene.background) == first
    assert len(calls) == 4
    picture = sorted((tmp_path / "store" / first.renders).glob("*.npy"))[0]
    for damage in (b"", picture.read_bytes()[:90], picture.read_bytes()[:-1]):
        picture.write_bytes(damage)
        with pytest.raises(SplatwireError, match=rf"{picture.name} is damaged: .*; remove its folder"):
            views.reference(0)
