import json
import math
import shutil

import numpy as np
import pytest
from PIL import Image

from splatwire.data import open_dataset
from splatwire.data.transforms_json import read_transforms
from splatwire.errors import DatasetError


def test_blender_poses_become_opencv(capture):
    views = read_transforms(capture.write_blender() / "transforms_test.json").views
    assert [view.name for view in views] == [f"test/r_{i}" for i in range(8, 12)]
    for i, view in enumerate(views, start=8):
        np.testing.assert_allclose(view.viewmat, capture.viewmat(i), atol=1e-9)
        np.testing.assert_allclose(view.K, [[33, 0, 20], [0, 33, 12], [0, 0, 1]], atol=1e-9)
        assert view.image_path == capture.root / "test" / f"r_{i}.png"


def test_nerfstudio_intrinsics_are_taken_as_given(capture):
    views = read_transforms(capture.write_nerfstudio() / "transforms.json").views
    for i, view in enumerate(views):
        np.testing.assert_allclose(view.viewmat, capture.viewmat(i), atol=1e-9)
        assert view.K.tolist() == [[33, 0, 19.5], [0, 35, 12.25], [0, 0, 1]]


def test_intrinsics_of_a_frame_override_global_ones(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][5]["fl_x"] = 50
    path.write_text(json.dumps(content))
    assert [view.K[0, 0] for view in read_transforms(path).views] == [33] * 5 + [50] + [33] * 6


def frame(**values):
    return lambda content: content["frames"][2].update(values)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda content: content.update(frames=[]), "has no views"),
        (lambda content: content.pop("frames"), "has no views"),
        (frame(file_path=3), "frame 2 has no 'file_path'"),
        (frame(file_path="images/absent.png"), "'images/absent.png' is missing"),
        (frame(file_path="../view_00.png"), "does not stay inside"),
        (frame(file_path="/etc/passwd"), "does not stay inside"),
        (frame(transform_matrix=None), "expected 4 x 4 numbers"),
        (frame(transform_matrix=[[float("nan")] * 4] * 4), "not finite"),
        (frame(transform_matrix=(3 * np.eye(4)).tolist()), "not a rotation"),
        (frame(k4=0.1), "a lens \\(k4\\)"),
        (frame(is_fisheye=True, p1=0.1), "a lens \\(p1\\)"),
        (frame(camera_model="EQUIRECTANGULAR"), "'camera_model' 'EQUIRECTANGULAR'"),
        (frame(camera_model="VR180_L", fl_x=None), "'camera_model' 'VR180_L'"),
        (frame(camera_model="FISHEYE624"), "'camera_model' 'FISHEYE624'"),
        (frame(latlong=True), "'latlong'"),
        (frame(latlong="no"), "'latlong' is 'no', neither true nor false"),
        (frame(is_fisheye="false"), "'is_fisheye' is 'false', neither true nor false"),
        (frame(is_fisheye=[]), "'is_fisheye' is '\\[\\]', neither"),
        (frame(camera_model=3), "'camera_model' is not a name"),
        (frame(file_path="images/" + "a" * 300), "File name too long"),
        (frame(file_path="images/" + "a" * 253), "File name too long"),
        (frame(file_path="a/" * 3000), "File name too long"),
        (frame(file_path="images/\ud800.png"), "missing|no name of a file"),
        (frame(mask_path="m" * 300), "File name too long"),
        (lambda content: content.update(ply_file_path="p" * 300), "File name too long"),
        (frame(transform_matrix=[["1", "0", "0", "0"]] * 4), "expected 4 x 4 numbers"),
        (lambda content: content.update(equirectangular=True), "'equirectangular'"),
        (lambda content: content.update(ply_file_path="gone.ply"), "point cloud 'gone.ply'"),
        (lambda content: content.update(ply_file_path="../gone.ply"), "does not stay inside"),
        (lambda content: content.update(ply_file_path=3), "'ply_file_path' is not a path"),
        (lambda content: content.update(train_filenames=["images/other.png"]), "'train_filenames' lists 'images/other"),
        (lambda content: content.update(val_filenames="images/view_00.png"), "'val_filenames' is not a list"),
        (frame(fl_x="wide"), "'fl_x' is not a sensible number"),
        (frame(w=0), "image size of 0 x 24"),
        (lambda content: content.pop("fl_x"), "neither 'fl_x' nor"),
    ],
)
def test_wrong_files_are_refused(spoil, reason, capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=reason) as caught:
        read_transforms(path)
    assert "transforms.json" in str(caught.value)


def test_vertical_field_of_view_is_accepted(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    del content["fl_x"], content["fl_y"]
    content["camera_angle_y"] = 2 * np.arctan(12 / 35)
    path.write_text(json.dumps(content))
    assert read_transforms(path).views[0].K[[0, 1], [0, 1]] == pytest.approx([35, 35])


def test_poses_of_three_rows_and_absolute_paths_inside_the_folder_are_read(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    expected = read_transforms(path).views
    content = json.loads(path.read_text())
    for one in content["frames"]:
        one["transform_matrix"] = one["transform_matrix"][:3]
        one["file_path"] = str((capture.root / one["file_path"]).absolute())
    path.write_text(json.dumps(content))
    found = read_transforms(path).views
    assert [view.image_path.resolve() for view in found] == [view.image_path.resolve() for view in expected]
    assert all(np.array_equal(a.viewmat, b.viewmat) for a, b in zip(found, expected, strict=True))


def _with_splits(capture, **splits):
    capture.write_nerfstudio(
        **{f"{name}_filenames": [f"./images/view_{i:02d}.png" for i in v] for name, v in splits.items()}
    )
    return {s: [n[-2:] for n in open_dataset(capture.root, split=s).cameras.names] for s in ("train", "test", "all")}


def test_listed_splits_are_used(capture):
    found = _with_splits(capture, train=(0, 1, 5), val=(7,), test=(2, 3))
    assert found["train"] == ["00", "01", "05"]
    assert found["test"] == ["02", "03"]
    assert len(found["all"]) == 12
    assert len(open_dataset(capture.root, split="test", test_views="every_8th").cameras.names) == 2


def test_validation_views_serve_as_test_views(capture):
    assert _with_splits(capture, train=(0, 1), val=(7, 8))["test"] == ["07", "08"]
    assert len(_with_splits(capture, train=range(9))["test"]) == 3
    assert len(_with_splits(capture, test=range(9))["train"]) == 3


@pytest.mark.parametrize("form", ["bytes", "text", "grey"])
def test_the_point_cloud_is_read(capture, form):
    points = np.array([[0.5, 1, 2], [3, -4, 5]])
    colors = ["property uchar red", "property uchar green", "property uchar blue"] * (form != "grey")
    kind = "ascii" if form == "text" else "binary_little_endian"
    head = [
        f"ply\nformat {kind} 1.0",
        "element vertex 2",
        *(f"property float {a}" for a in "xyz"),
        *colors,
        "end_header",
    ]
    if form == "text":
        body = b"0.5 1 2 255 0 51\n3 -4 5 0 255 51\n"
    else:
        ends = (bytes((255, 0, 51)), bytes((0, 255, 51))) if colors else (b"", b"")
        body = b"".join(p.astype("<f4").tobytes() + end for p, end in zip(points, ends, strict=True))
    capture.root.mkdir()
    (capture.root / "sparse_pc.ply").write_bytes(("\n".join(head) + "\n").encode() + body)
    capture.write_nerfstudio(ply_file_path="sparse_pc.ply")
    found = open_dataset(capture.root, split="train").points
    assert np.array_equal(found.positions, points.astype(np.float32))
    expected = [[0.5] * 3] * 2 if form == "grey" else [[1, 0, 0.2], [0, 1, 0.2]]
    np.testing.assert_allclose(found.colors, expected, rtol=1e-6)


def test_a_byte_order_mark_is_skipped(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    before = [view.name for view in read_transforms(path).views]
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert [view.name for view in read_transforms(path).views] == before


@pytest.mark.parametrize("value", [False, None, 0])
def test_fisheye_without_distortion_is_a_pinhole(value, capture):
    path = capture.write_nerfstudio(is_fisheye=value) / "transforms.json"
    assert not any(view.lens.has_distortion for view in read_transforms(path).views)


def rewritten(path, **values):
    path.write_text(json.dumps(json.loads(path.read_text()) | values))
    return path


def test_listed_distortion_is_that_of_the_named_terms(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    listed = read_transforms(rewritten(path, distortion_params=[0.1, 0.02, 0, 0, 0.001, -0.002])).views[0].lens
    named = read_transforms(rewritten(path, distortion_params=None, k1=0.1, k2=0.02, p1=0.001, p2=-0.002)).views[0].lens
    assert listed == named
    for values, problem in (
        ([0.1] * 12, "'distortion_params' is not the list k1, k2, k3, k4, p1, p2"),
        ([0.2, 0.02, 0, 0, 0.001, -0.002], "has two values of k1"),
        ([0.1, 0.02, 0, 0, 0.001, "x"], "has two values of p2"),
    ):
        with pytest.raises(DatasetError, match=problem):
            read_transforms(rewritten(path, distortion_params=values))


@pytest.mark.parametrize("key", ["camera_convention", "coordinate_system", "pose_convention", "convention"])
def test_other_axes_of_poses_give_a_warning(key, capture, caplog):
    path = capture.write_nerfstudio() / "transforms.json"
    read_transforms(rewritten(path, **{key: "opengl"}))
    assert not caplog.text
    read_transforms(rewritten(path, **{key: "OpenCV"}))
    assert f"{key} is 'OpenCV': poses are read with OpenGL axes" in caplog.text


def test_the_name_of_a_camera_is_no_statement_about_axes(capture, caplog):
    path = capture.write_nerfstudio() / "transforms.json"
    read_transforms(rewritten(path, camera="iPhone 14 Pro"))
    assert not caplog.messages
    read_transforms(rewritten(path, camera="OpenCV"))
    assert "camera is 'OpenCV': poses are read with OpenGL axes" in caplog.text


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("camera_type", "fisheye"),
        ("lens_model", "EQUIRECTANGULAR"),
        ("projection", "spherical"),
        ("fisheye", True),
        ("is_equirectangular", 1),
        ("distortion", [0, 0.1, 0, 0]),
        ("distortion_coefficients", {"k1": 0.1}),
        ("dist_coeffs", [0.1]),
        ("s1", 0.01),
        ("skew", 0.5),
        ("sk_x", 0.5),
        ("model", "fisheye"),
        ("cam_model", "fisheye"),
        ("sensor_type", "spherical"),
        ("distortion_model", "equidistant"),
        ("lens_mode", "OpenCVFisheye"),
        ("projection_mode", "orthographic"),
        ("camera_type", "ORTHO"),
        ("camera_type", "PANO"),
        ("is_ortho", True),
        ("camera", {"model": "OPENCV_FISHEYE", "k1": 0}),
        ("camera", {"id": 1, "k1": 0.1}),
        ("lens", {"type": "fisheye"}),
        ("lens", {"distortion": [0, 0.1]}),
        ("cameras", [{"id": 1}, {"projection": "equirectangular"}]),
    ],
)
def test_a_lens_under_an_unknown_name_is_refused(key, value, capture):
    path = capture.write_nerfstudio() / "transforms.json"
    with pytest.raises(DatasetError, match=f"'{key}', which may state a lens"):
        read_transforms(rewritten(path, **{key: value}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("camera_type", "perspective"),
        ("fisheye_crop_radius", 900.0),
        ("fisheye", False),
        ("distortion", [0, 0.0]),
        ("dist", 3.5),
        ("scene", "fisheye"),
        ("camera", "left"),
        ("distortion_model", "radtan"),
        ("lens_mode", "wide"),
        ("image", "fisheye/1.png"),
        ("camera_name", "fisheye"),
        ("camera", {"model": "OPENCV", "k1": 0.0, "is_fisheye": False, "name": "fisheye"}),
        ("model", "splatfacto"),
        ("cameras", [{"id": 1, "distortion": []}, 2]),
        ("matrix", np.eye(4).tolist()),
    ],
)
def test_fields_that_state_no_lens_are_accepted(key, value, capture, caplog):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][1][key] = value
    path.write_text(json.dumps(content))
    assert len(read_transforms(path).views) == 12
    assert not caplog.text


def test_intrinsics_in_shares_of_the_size_are_refused(capture):
    folder = capture.write_nerfstudio()
    rewritten(folder / "transforms.json", fl_x=0.8, fl_y=1.1, cx=0.5, cy=0.5)
    with pytest.raises(DatasetError, match="in pixels, not in shares of the size"):
        open_dataset(folder)


def test_deep_lists_in_fields_of_a_lens_are_no_endless_recursion(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    deep: list = []
    for _ in range(600):
        deep = [deep]
    assert len(read_transforms(rewritten(path, distortion=deep)).views) == 12


def test_other_axes_of_the_poses_of_frames_give_one_warning(capture, caplog):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        frame["camera_convention"] = "opencv"
    path.write_text(json.dumps(content))
    read_transforms(path)
    assert caplog.text.count("camera_convention is 'opencv': poses are read with OpenGL axes") == 1


@pytest.mark.parametrize("key", ["intrinsics", "K", "intrinsic_matrix", "camera_matrix", "camera_intrinsics"])
@pytest.mark.parametrize("form", ["3x3", "4x4", "9"])
def test_intrinsics_of_a_frame_may_be_a_matrix(key, form, capture):
    """They replace the common `fl_x`, as `fl_x` of the frame does."""
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    K = [[90.5, 0, 31.0], [0, 91.5, 29.0], [0, 0, 1]]
    forms = {"3x3": K, "4x4": [*([*row, 0] for row in K), [0, 0, 0, 1]], "9": [*K[0], *K[1], *K[2]]}
    content["frames"][1][key] = forms[form]
    path.write_text(json.dumps(content))
    before, view = read_transforms(path).views[:2]
    assert view.K.tolist() == K
    assert before.K.tolist() != K
    content["frames"][1] |= {"fl_x": 90.5, "fx": 90.5, "fl_y": 91.5}
    path.write_text(json.dumps(content))
    assert read_transforms(path).views[1].K.tolist() == K


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"intrinsics": [[90, 0, 31], [0, 90, 29], [0, 0, 1]], "fl_x": 80.0}, "two values of fl_x, 80 and 90"),
        ({"fx": 70.0, "fl_x": 80.0}, "two values of fl_x"),
        ({"K": [90, 0, 0, 0, 90, 0, 31, 29, 1]}, "'K', which is not"),
        ({"intrinsics": [[90, 3, 31], [0, 90, 29], [0, 0, 1]]}, "'intrinsics', which is not"),
        ({"intrinsics": [90, 90, 31, 29]}, "no 3 x 3 matrix"),
        ({"intrinsics": {"f": 90}}, "no 3 x 3 matrix"),
        ({"intrinsics": "intrinsics/1.txt"}, "no 3 x 3 matrix"),
        ({"fx": "90"}, "not a sensible number"),
        ({"camera_angle_x": 0.9}, "'camera_angle_x' of 0.9, but focal lengths of 33"),
        ({"camera_angle_y": 1.3}, "'camera_angle_y' of 1.3"),
        ({"fov": 190}, "'fov' of 190"),
        ({"hfov": 37.84}, "'hfov' of 37.84"),
    ],
)
def test_unclear_intrinsics_are_refused(fields, problem, capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][1] |= fields
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=problem):
        read_transforms(path)


def test_angles_of_view_of_the_focal_lengths_are_accepted(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    across, down = (2 * math.atan(side / 2 / focal) for side, focal in zip((40, 24), (33.0, 35.0), strict=True))
    angles = {"camera_angle_x": across, "camera_angle_y": down, "vfov": math.degrees(down), "fov": across}
    views = read_transforms(path).views
    again = read_transforms(rewritten(path, **angles)).views
    assert [view.K.tolist() for view in again] == [view.K.tolist() for view in views]


@pytest.mark.parametrize("focal", [{}, {"fl_x": 50 / 36 * 40, "fl_y": 50 / 36 * 40}])
@pytest.mark.parametrize("is_swapped", [False, True])
def test_vertical_angles_of_the_sensor_of_blender_are_no_contradiction(focal, is_swapped, capture, caplog):
    """As written by BlenderNeRF, and by scripts that write `camera.data.angle_y`: that of a sensor of 36 x 24 mm."""
    path = capture.write_nerfstudio() / "transforms.json"
    across = 2 * math.atan(18 / 50)
    down = 2 * math.atan(27 / 50) if is_swapped else 2 * math.atan(12 / 50)
    content = json.loads(path.read_text())
    del content["fl_x"], content["fl_y"]
    path.write_text(json.dumps(content | focal | {"camera_angle_x": across, "camera_angle_y": down}))
    K = read_transforms(path).views[0].K
    assert K[[0, 1], [0, 1]] == pytest.approx([50 / 36 * 40] * 2)
    assert not caplog.messages


@pytest.mark.parametrize("sensor", [(32, 24), (24.89, 18.66), (23.6, 15.6)])
def test_vertical_angles_of_other_sensors_of_blender_are_no_contradiction(sensor, capture):
    """As written by BlenderNeRF: the other three values agree, and the vertical angle is not needed."""
    path, (across, down) = capture.write_nerfstudio() / "transforms.json", sensor
    focal = 35 / across * 40
    angles = {f"camera_angle_{axis}": 2 * math.atan(side / 70) for axis, side in (("x", across), ("y", down))}
    K = read_transforms(rewritten(path, fl_x=focal, fl_y=focal, **angles)).views[0].K
    assert K[[0, 1], [0, 1]] == pytest.approx([focal] * 2)
    with pytest.raises(DatasetError, match="camera_angle_y"):
        read_transforms(rewritten(path, fl_y=1.1 * focal))
    with pytest.raises(DatasetError, match="camera_angle_x"):
        read_transforms(rewritten(path, fl_y=focal, camera_angle_x=1.1 * angles["camera_angle_x"]))


def test_focal_lengths_of_frames_may_differ_from_a_common_angle_of_view(capture):
    """As in captures of phones, which change the focus for each frame."""
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text()) | {"camera_angle_x": 2 * math.atan(20 / 33)}
    content["frames"][1] |= {"fl_x": 34.0, "fl_y": 36.0}
    path.write_text(json.dumps(content))
    assert read_transforms(path).views[1].K[[0, 1], [0, 1]].tolist() == [34, 36]


def test_two_angles_of_view_are_those_of_pixels_that_are_not_quite_square(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    del content["fl_x"], content["fl_y"]
    content |= {"camera_angle_x": 2 * math.atan(20 / 33), "camera_angle_y": 2 * math.atan(12 / 33.2)}
    path.write_text(json.dumps(content))
    assert read_transforms(path).views[0].K[[0, 1], [0, 1]] == pytest.approx([33, 33.2])


@pytest.mark.parametrize("factor", [0.5, 2])
def test_intrinsics_of_another_picture_size_give_a_warning(factor, capture, caplog):
    folder = capture.write_nerfstudio()
    open_dataset(folder)
    assert not caplog.messages
    terms = {"fl_x": 33.0, "fl_y": 35.0, "cx": 20.0, "cy": 12.0}
    rewritten(folder / "transforms.json", **{key: value * factor for key, value in terms.items()})
    open_dataset(folder)
    assert "the intrinsics may be those of another picture size" in caplog.text


@pytest.mark.parametrize(("model", "flag"), [("OPENCV", True), ("OPENCV_FISHEYE", False), ("PINHOLE", 1)])
def test_lenses_that_contradict_each_other_are_refused(model, flag, capture):
    path = capture.write_nerfstudio() / "transforms.json"
    with pytest.raises(DatasetError, match=f"'camera_model' '{model}' and 'is_fisheye' {bool(flag)}, which contradict"):
        read_transforms(rewritten(path, camera_model=model, is_fisheye=flag))
    read_transforms(rewritten(path, camera_model=model, is_fisheye=None))


def test_a_crop_radius_gives_a_warning(capture, caplog):
    read_transforms(capture.write_nerfstudio() / "transforms.json")
    assert not caplog.text
    read_transforms(capture.write_nerfstudio(fisheye_crop_radius=11.5, is_fisheye=True) / "transforms.json")
    assert "'fisheye_crop_radius' is not read" in caplog.text


def test_test_frames_beside_the_frames_give_a_warning(capture, caplog):
    read_transforms(capture.write_nerfstudio(test_frames=[{"file_path": "images/other.png"}]) / "transforms.json")
    assert "'test_frames' is not read: all views are those of 'frames', test views too" in caplog.text


def test_frames_of_several_times_give_a_warning(capture, caplog):
    path = capture.write_nerfstudio() / "transforms.json"
    content = json.loads(path.read_text())
    for step, problem in ((0, False), (0.25, True)):
        for number, frame in enumerate(content["frames"]):
            frame["time"] = number * step
        path.write_text(json.dumps(content))
        read_transforms(path)
        assert ("its frames are of 12 times, 0 to 2.75" in caplog.text) == problem


@pytest.mark.parametrize(
    ("fields", "warned"),
    [
        ({"world_to_camera": True}, True),
        ({"transform_matrix_type": "w2c"}, True),
        ({"is_w2c": False}, False),
        ({"transform_matrix_type": "c2w"}, False),
    ],
)
def test_poses_from_world_to_camera_give_a_warning(fields, warned, capture, caplog):
    read_transforms(rewritten(capture.write_nerfstudio() / "transforms.json", **fields))
    assert ("states poses from world to camera: they are read as camera to world" in caplog.text) == warned


def test_a_pinhole_camera_with_distortion_is_refused(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    read_transforms(rewritten(path, camera_model="PINHOLE", k1=0))
    with pytest.raises(DatasetError, match="'camera_model' 'PINHOLE' and the distortion of a lens"):
        read_transforms(rewritten(path, camera_model="PINHOLE", k1=0.05))


@pytest.fixture
def halved(capture):
    """A nerfstudio folder with photos of half the size in `images_2`, and a file without `w`, `h`, `cx` and `cy`."""
    folder = capture.write_nerfstudio()
    (folder / "images_2").mkdir()
    for photo in (folder / "images").iterdir():
        with Image.open(photo) as image:
            image.resize((image.width // 2, image.height // 2)).save(folder / "images_2" / photo.name)
    content = json.loads((folder / "transforms.json").read_text())
    for key in ("w", "h", "cx", "cy"):
        del content[key]
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def test_intrinsics_without_a_size_are_those_of_the_photos_that_the_file_names(halved):
    assert open_dataset(halved).cameras.Ks[0, [0, 1], [0, 1]].tolist() == [33, 35]
    assert open_dataset(halved, images="images_2").cameras.Ks[0, [0, 1], [0, 1]].tolist() == [16.5, 17.5]
    shutil.rmtree(halved / "images")
    with pytest.raises(DatasetError, match=r"'fl_x' for the photo 'images/.*', which is missing, and no 'w' and 'h'"):
        open_dataset(halved, images="images_2")


@pytest.mark.parametrize("names", [("width", "height"), ("image_width", "image_height"), ("img_w", "img_h")])
def test_the_picture_size_may_have_other_names(names, halved):
    rewritten(halved / "transforms.json", **dict(zip(names, (80, 48), strict=True)))
    assert open_dataset(halved).cameras.Ks[0, [0, 1], [0, 1]].tolist() == [16.5, 17.5]
    rewritten(halved / "transforms.json", w=40, h=24)
    assert open_dataset(halved).cameras.Ks[0, [0, 1], [0, 1]].tolist() == [33, 35]


@pytest.mark.parametrize("key", ["w", "h"])
def test_half_of_a_picture_size_must_be_that_of_the_photo(key, halved):
    rewritten(halved / "transforms.json", **{key: {"w": 40, "h": 24}[key]})
    open_dataset(halved)
    rewritten(halved / "transforms.json", **{key: 96})
    with pytest.raises(DatasetError, match=f"'{key}' of 96 without the other side, but its photo is 40 x 24"):
        open_dataset(halved)


def lenses_of_two_frames(path, common, own):
    content = json.loads(path.read_text()) | common
    content["frames"][0] |= own
    path.write_text(json.dumps(content))
    return [view.lens for view in read_transforms(path).views[:2]]


def test_lens_parameters_of_a_frame_replace_those_of_the_file(capture):
    path = capture.write_nerfstudio() / "transforms.json"
    listed, named = {"distortion_params": [0.1, 0.02, 0, 0, 0.001, -0.002]}, {"k1": 0.1, "k2": 0.02, "p1": 0.001}
    for common in (listed, named):
        own, shared = lenses_of_two_frames(path, {"distortion_params": None, **common}, {"k1": 0})
        assert (own.k1, own.k2, own.p1) == (0, 0.02, 0.001)
        assert (shared.k1, shared.k2, shared.p1) == (0.1, 0.02, 0.001)
    other = {"distortion_params": [0.3, 0, 0, 0, 0, 0]}
    own, shared = lenses_of_two_frames(path, listed | dict.fromkeys(named, 0), other)
    assert (own.k1, own.k2, own.p1) == (0.3, 0, 0)
    assert (shared.k1, shared.k2, shared.p1) == (0.1, 0.02, 0.001)
