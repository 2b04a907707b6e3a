import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import assert_close
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.errors import DatasetError
from splatwire.files.kinds import CAMERAS, file_kind

DATA = Path(os.environ.get("SPLATWIRE_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


@pytest.fixture
def cameras(capture):
    capture.write_images()
    capture.write_binary()
    return open_dataset(capture.root, split="all").cameras


def test_cameras_round_trip_bit_identically(cameras, tmp_path):
    save_cameras(cameras, tmp_path / "c.json")
    back = load_cameras(tmp_path / "c.json")
    assert np.array_equal(back.viewmats, cameras.viewmats)
    assert np.array_equal(back.Ks, cameras.Ks)
    assert (back.names, back.width, back.height) == (cameras.names, 40, 24)
    assert not list(tmp_path.glob(".*"))


def official(cameras):
    views = [
        {"name": n, "width": 40, "height": 24, "K": K.tolist(), "w2c": viewmat.tolist()}
        | {"FoVx": 2 * math.atan(20 / K[0, 0])}
        for n, K, viewmat in zip(cameras.names, cameras.Ks, cameras.viewmats, strict=True)
    ]
    return {"convention": "w2c", "cameras": views}


def test_the_official_file_is_read(cameras, tmp_path):
    (tmp_path / "cameras.json").write_text(json.dumps(official(cameras)))
    back = load_cameras(tmp_path / "cameras.json")
    assert np.array_equal(back.viewmats, cameras.viewmats)
    assert np.array_equal(back.Ks, cameras.Ks)
    assert back.names == cameras.names


def change(**values):
    return lambda content: content["cameras"][3].update(values)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda content: content.update(cameras=[]), "has no views"),
        (lambda content: content.update(cameras={}), "no list 'cameras'"),
        (lambda content: content["cameras"].append(3), "a camera has no name"),
        (lambda content: content.update(format="splatwire-cameras", version=9), "version 9, this release reads 1"),
        (change(width=41), "2 different image sizes"),
        (change(K=[[1, 2], [3, 4]]), "'view_03': expected 3 x 3 numbers"),
        (change(w2c="here"), "expected 4 x 4 numbers"),
        (change(w2c=[[float("nan")] * 4] * 4), "pose of view 'view_03' is not finite"),
        (change(w2c=(2 * np.eye(4)).tolist()), "'view_03' is not a rotation"),
        (change(w2c=np.diag([1, 1, -1, 1]).tolist()), "'view_03' is not a rotation"),
        (change(K=np.diag([-1, 1, 1]).tolist()), "'view_03' has no positive"),
        (change(c2w=np.eye(4).tolist()), "'view_03' has 'c2w', which contradicts its other fields"),
        (change(fov=3.0), "'view_03' has a 'fov' of 3"),
        (change(K=[[33, 4, 20], [0, 33, 12], [0, 0, 1]]), "of view 'view_03' are not .fx 0 cx; 0 fy cy; 0 0 1."),
        (change(K=[[33, 0, 0], [0, 33, 0], [20, 12, 1]]), "of view 'view_03' are not"),
    ],
)
def test_wrong_files_are_refused(spoil, reason, cameras, tmp_path):
    content = official(cameras)
    spoil(content)
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=reason) as caught:
        load_cameras(tmp_path / "c.json")
    assert "c.json" in str(caught.value)


def test_one_camera_without_a_list_is_not_said_to_be_no_cameras_file(tmp_path):
    view = {"img_name": "0", "width": 40, "height": 24, "position": [0, 0, 0], "rotation": np.eye(3).tolist()}
    (tmp_path / "c.json").write_text(json.dumps(view | {"fx": 30, "fy": 30}))
    with pytest.raises(DatasetError, match=r"c\.json: looks like a cameras file, but it has no list 'cameras'$"):
        load_cameras(tmp_path / "c.json")


def test_invalid_json_is_refused(tmp_path):
    (tmp_path / "c.json").write_text("{")
    with pytest.raises(DatasetError, match="not readable JSON"):
        load_cameras(tmp_path / "c.json")
    with pytest.raises(DatasetError, match="no such file"):
        load_cameras(tmp_path / "absent.json")


def cameras_of_3dgs(cameras):
    """Camera list as 3DGS writes it; poses are camera to world."""
    entries = []
    for number, (name, K, viewmat) in enumerate(zip(cameras.names, cameras.Ks, cameras.viewmats, strict=True)):
        rotation = viewmat[:3, :3].astype(np.float64).T
        position = -rotation @ viewmat[:3, 3].astype(np.float64)
        entries.append({"id": number, "img_name": name, "width": 40, "height": 24, "position": position.tolist(),
                        "rotation": rotation.tolist(), "fx": float(K[0, 0]), "fy": float(K[1, 1])})  # fmt: skip
    return entries


def test_the_cameras_of_a_model_folder_of_3dgs_are_read(cameras, tmp_path):
    (tmp_path / "cameras.json").write_text(json.dumps(cameras_of_3dgs(cameras)))
    back = load_cameras(tmp_path / "cameras.json")
    assert_close(back.viewmats, cameras.viewmats, rtol=1e-6, atol=1e-6)
    assert np.array_equal(back.Ks, cameras.Ks)
    assert (back.names, back.width, back.height) == (cameras.names, 40, 24)
    assert file_kind(tmp_path / "cameras.json") == CAMERAS


def entry(**values):
    return lambda content: content[3].update(values)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda content: content.clear(), "has no views"),
        (lambda content: content.append(3), "a list must hold cameras"),
        (lambda content: content[3].pop("fy"), "a list must hold cameras"),
        (lambda content: content[3].pop("width"), "width and height must be whole numbers"),
        (entry(width=41), "2 different image sizes"),
        (entry(fx="wide"), "'view_03': expected"),
        (entry(fx=-3), "'view_03' has no positive"),
        (entry(position=[1, 2]), "'view_03': expected"),
        (entry(rotation=[[1, 0], [0, 1]]), "'view_03': expected 3 x 3 numbers"),
        (entry(rotation=[["1", "0", "0"], ["0", "1", "0"], ["0", "0", "1"]]), "'view_03': expected 3 x 3 numbers"),
        (entry(position="here"), "'view_03': expected 1 x 3 numbers"),
        (entry(position=[True, 0, 0]), "'view_03': expected 1 x 3 numbers"),
        (entry(fx="30"), "'view_03': expected 1 x 2 numbers"),
        (entry(fy=None), "'view_03': expected 1 x 2 numbers"),
        (entry(img_name=[3]), "has the name '\\[3\\]', which is no text"),
        (entry(img_name=None), "has the name 'None', which is no text"),
        (entry(img_name="\ud800"), "which is no text"),
        (entry(rotation=(2 * np.eye(3)).tolist()), "'view_03' is not a rotation"),
        (entry(position=[float("nan")] * 3), "'view_03' is not finite"),
        (entry(K=[[99, 0, 20], [0, 99, 12], [0, 0, 1]]), "'view_03' has 'K', which contradicts its other fields"),
        (entry(w2c=np.eye(4).tolist()), "'view_03' has 'w2c', which contradicts its other fields"),
        (entry(FovX=0.5), "'view_03' has a 'FovX' of 0.5, but focal lengths of"),
    ],
)
def test_wrong_cameras_of_3dgs_are_refused(spoil, reason, cameras, tmp_path):
    content = cameras_of_3dgs(cameras)
    spoil(content)
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=reason) as caught:
        load_cameras(tmp_path / "cameras.json")
    assert "cameras.json" in str(caught.value)


@pytest.mark.data
@pytest.mark.parametrize(
    ("scene", "model"),
    [("bonsai", "bonsai_30k"), ("snowmiku", "snowmiku_15k"), ("snowmiku_small", "snowmiku_small_2400")],
)
def test_test_views_equal_the_official_ones(scene, model):
    if not (DATA / "scenes" / scene).is_dir():
        pytest.skip(f"no photos under {DATA / 'scenes' / scene} (set SPLATWIRE_DATA)")
    dataset = open_dataset(DATA / "scenes" / scene, split="test")
    theirs = load_cameras(DATA / "hacpp" / model / "cameras.json")
    assert dataset.cameras.names == theirs.names
    assert (dataset.cameras.width, dataset.cameras.height) == (theirs.width, theirs.height)
    assert_close(dataset.cameras.Ks, theirs.Ks, atol=1e-3, rtol=0)
    assert_close(dataset.cameras.viewmats, theirs.viewmats, atol=1e-5, rtol=0)
    assert dataset.image(0).shape == (theirs.height, theirs.width, 3)


def test_3dgs_cameras_keep_a_principal_point_off_the_centre(cameras, tmp_path):
    poses = np.linalg.inv(cameras.viewmats.astype(np.float64))
    views = [
        {"id": i, "img_name": n, "position": pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()}
        | {"width": 40.0, "height": 24.0, "fx": 33, "fy": 35}
        for i, (n, pose) in enumerate(zip(cameras.names, poses, strict=True))
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(views))
    assert load_cameras(tmp_path / "cameras.json").Ks[0].tolist() == [[33, 0, 20], [0, 35, 12], [0, 0, 1]]
    views[0] |= {"cx": 17.5, "cy": 10.25}
    (tmp_path / "cameras.json").write_text(json.dumps(views))
    back = load_cameras(tmp_path / "cameras.json")
    assert back.Ks[0].tolist() == [[33, 0, 17.5], [0, 35, 10.25], [0, 0, 1]]
    assert back.Ks[1].tolist() == [[33, 0, 20], [0, 35, 12], [0, 0, 1]]
    views[0]["width"] = 40.5
    (tmp_path / "cameras.json").write_text(json.dumps(views))
    with pytest.raises(DatasetError, match="whole numbers"):
        load_cameras(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"k1": 0.1, "p2": 0}, "k1"),
        ({"camera_model": "OPENCV_FISHEYE"}, "camera_model"),
        ({"distortion": [0.1, 0], "k1": 0}, "distortion"),
        ({"camera_model": "PINHOLE", "k1": 0, "distortion": []}, None),
    ],
)
def test_a_lens_of_a_3dgs_camera_gives_a_warning(fields, named, tmp_path, caplog):
    view = {"img_name": "a", "width": 40, "height": 24, "position": [0, 0, 0], "rotation": np.eye(3).tolist()}
    (tmp_path / "cameras.json").write_text(json.dumps([view | {"fx": 33, "fy": 33} | fields]))
    load_cameras(tmp_path / "cameras.json")
    if named is None:
        assert not caplog.text
    else:
        assert f"fields about a lens are left out: {named};" in caplog.text


def test_fields_that_repeat_a_camera_are_accepted(cameras, tmp_path, caplog):
    content = cameras_of_3dgs(cameras)
    for view, viewmat, K in zip(content, cameras.viewmats, cameras.Ks, strict=True):
        more = {
            "w2c": viewmat.tolist(),
            "c2w": np.linalg.inv(viewmat).tolist(),
            "K": K.tolist(),
            "convention": "OpenCV",
            "camera": "left",
        }
        view.update(more)
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    assert_close(load_cameras(tmp_path / "cameras.json").viewmats, cameras.viewmats, rtol=1e-6, atol=1e-6)
    for view in content:
        view["K"] = np.ravel(view["K"]).tolist()
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    load_cameras(tmp_path / "cameras.json")
    assert not caplog.messages


def test_other_axes_of_cameras_give_one_warning(cameras, tmp_path, caplog):
    content = cameras_of_3dgs(cameras)
    for view in content:
        view["coordinate_system"] = "opengl"
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    load_cameras(tmp_path / "cameras.json")
    assert caplog.text.count("coordinate_system is 'opengl': poses are read with OpenCV axes") == 1


def test_own_cameras_of_another_convention_or_size_are_named(cameras, tmp_path, caplog):
    save_cameras(cameras, tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    load_cameras(tmp_path / "c.json")
    assert not caplog.messages
    (tmp_path / "c.json").write_text(json.dumps(content | {"convention": "viewmat: camera to world"}))
    load_cameras(tmp_path / "c.json")
    assert "convention is 'viewmat: camera to world'" in caplog.text
    content["cameras"][2] |= {"width": 20, "height": 12}
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="2 different image sizes"):
        load_cameras(tmp_path / "c.json")


def test_near_plane_round_trips_and_must_be_positive(cameras, tmp_path):
    assert "near_depth" not in saved(cameras, tmp_path)
    content = saved(replace(cameras, near_depth=1e-4), tmp_path)
    assert load_cameras(tmp_path / "c.json").near_depth == 1e-4
    for bad in (0, -1, 1e400, "near", None):
        (tmp_path / "bad.json").write_text(json.dumps(content | {"near_depth": bad}))
        with pytest.raises(DatasetError, match="near_depth"):
            load_cameras(tmp_path / "bad.json")


def saved(cameras, folder):
    save_cameras(cameras, folder / "c.json")
    return json.loads((folder / "c.json").read_text())


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"cx": 0, "cy": 0}, [0, 0]),  # the lower right quarter of a picture
        ({"cx": -0.5, "cy": 0.5}, [-0.5, 0.5]),
        ({"cx": 17.5}, [17.5, 12]),
        ({"cx": 17.5, "cy": None}, [17.5, 12]),
        ({"cx": 17.5, "principal_point": [17.5, 10.25]}, [17.5, 10.25]),
        ({"cy": 10.25, "pp": [17.5, 10.25]}, [17.5, 10.25]),
    ],
)
def test_principal_points_of_cut_pictures_and_partly_stated_ones_are_read(fields, expected, cameras, tmp_path):
    content = cameras_of_3dgs(cameras)
    for name in ("cx", "cy"):
        content[0].pop(name, None)
    (tmp_path / "cameras.json").write_text(json.dumps([content[0] | fields, *content[1:]]))
    assert load_cameras(tmp_path / "cameras.json").Ks[0, :2, 2].tolist() == expected


@pytest.mark.parametrize("key", ["principal_point", "principalPoint", "pp"])
def test_principal_points_of_3dgs_cameras_are_read(key, cameras, tmp_path):
    path, content = tmp_path / "cameras.json", cameras_of_3dgs(cameras)
    content[0][key] = [17.5, 10.25]
    path.write_text(json.dumps(content))
    assert load_cameras(path).Ks[:2, :2, 2].tolist() == [[17.5, 10.25], [20, 12]]
    content[0] |= {"cx": 17.5, "cy": 10.25}
    path.write_text(json.dumps(content))
    assert load_cameras(path).Ks[0, :2, 2].tolist() == [17.5, 10.25]
    for fields, message in [
        ({"cx": 18.5}, "two different principal points"),
        ({"cx": 0.5, "cy": 0.5, key: [0.5, 0.5]}, "must be in pixels"),
        ({key: [17.5]}, "expected 1 x 2 numbers"),
        ({key: "centre"}, "expected 1 x 2 numbers"),
    ]:
        path.write_text(json.dumps([content[0] | fields, *content[1:]]))
        with pytest.raises(DatasetError, match=message):
            load_cameras(path)


@pytest.mark.parametrize("form", ["own", "hacpp", "3dgs"])
def test_repeated_names_of_views_get_numbers_and_a_warning(form, cameras, tmp_path, caplog):
    save_cameras(cameras, tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text()) if form == "own" else official(cameras)
    views = content["cameras"]
    for view in views[1:4]:
        view["name"] = "view_00"
    views[4]["name"] = "view_00_2"
    if form == "3dgs":
        content = [
            {"img_name": view["name"], "width": 40, "height": 24, "fx": 33, "fy": 35, "position": [0, 0, 1]}
            | {"rotation": np.eye(3).tolist()}
            for view in views
        ]
    (tmp_path / "c.json").write_text(json.dumps(content))
    names = load_cameras(tmp_path / "c.json").names
    assert names[:5] == ("view_00", "view_00_3", "view_00_4", "view_00_5", "view_00_2")
    assert names[5:] == cameras.names[5:]
    assert (
        "3 of 12 views have the name of an earlier view and get a number, first 'view_00': 'view_00_3'" in caplog.text
    )
