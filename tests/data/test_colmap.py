import os
import re
import shutil
import struct
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from splatwire.data import _colmap_binary, _colmap_text, dataset_layout, open_dataset
from splatwire.data._checks import child
from splatwire.data.colmap import find_reconstruction, read_points, read_views
from splatwire.errors import DatasetError
from splatwire.files.kinds import DATASET, PHOTOS, file_kind


@pytest.mark.skipif(os.name == "nt", reason="a colon is not allowed in names of Windows")
def test_names_with_times_are_read(capture):
    capture.names = [f"2024-05-01T12:30:{number:02d}.png" for number in range(12)]
    capture.write_images()
    capture.write_binary()
    assert open_dataset(capture.root, split="all").cameras.names[3] == "2024-05-01T12:30:03"


@pytest.mark.parametrize("form", ["binary", "text"])
def test_text_and_binary_models_give_equal_values(capture, form):
    folder = capture.write_binary() if form == "binary" else capture.write_text()
    assert find_reconstruction(capture.root) == folder
    views = read_views(folder)
    assert [view.name for view in views] == sorted(capture.names)
    for view, i in zip(views, capture.sorted_views, strict=True):
        np.testing.assert_allclose(view.viewmat, capture.viewmat(i), atol=1e-12)
        assert view.K.tolist() == [[33, 0, 20], [0, 35, 12], [0, 0, 1]]
        assert (view.width, view.height) == (40, 24)
    points = read_points(folder)
    assert points.num_points == 5
    assert np.array_equal(points.positions, capture.points.astype(np.float32))
    assert np.array_equal(points.colors, capture.colors.astype(np.float32) / 255)


def test_a_ply_of_points_in_place_of_the_table_is_read(capture):
    folder = capture.write_text()
    expected = read_points(folder)
    rows = [" ".join(map(str, (*p, *c))) for p, c in zip(capture.points.tolist(), capture.colors.tolist(), strict=True)]
    types = [
        f"property {'uchar' if len(name) > 1 else 'double'} {name}" for name in ("x", "y", "z", "red", "green", "blue")
    ]
    lines = ["ply", "format ascii 1.0", "element vertex 5", *types, "end_header", *rows]
    (folder / "points3D.ply").write_text("\n".join(["ply"]))  # not read beside the table
    assert np.array_equal(read_points(folder).positions, expected.positions)
    (folder / "points3D.txt").unlink()
    (folder / "points3D.ply").write_text("\n".join(lines) + "\n")
    found = read_points(folder)
    assert np.array_equal(found.positions, expected.positions)
    assert np.array_equal(found.colors, expected.colors)


@pytest.mark.parametrize("place", ["", "sparse/0"])
def test_a_list_of_test_views_gives_a_warning(capture, caplog, place):
    capture.write_images()
    capture.write_binary()
    open_dataset(capture.root)
    assert not caplog.text
    (capture.root / place / "test.txt").write_text("view_01.png\n")
    open_dataset(capture.root)
    assert "test.txt is not read: of the photos in the order of their names, every eighth are test views" in caplog.text


def test_simple_pinhole_has_one_focal_length(capture):
    view = read_views(capture.write_binary("SIMPLE_PINHOLE", (31.0, 19.0, 11.0)))[0]
    assert view.K.tolist() == [[31, 0, 19], [0, 31, 11], [0, 0, 1]]


def test_a_panorama_is_refused_by_name(capture):
    folder = capture.write_binary("EQUIRECTANGULAR", (40.0, 24.0))
    with pytest.raises(DatasetError, match=r"EQUIRECTANGULAR.*perspective"):
        read_views(folder)


def _texts(capture, second, newline="\n", extra=""):
    """Text files with this second line of images; None for no second line."""
    folder = capture.write_text()
    lines = (folder / "images.txt").read_text().splitlines()
    images = [line for line in lines[1:] if len(line.split()) >= 10]
    assert len(images) == 12
    rows = [row for image in images for row in ([image] if second is None else [image, second])]
    (folder / "images.txt").write_bytes((newline.join([lines[0], extra, *rows]) + newline).encode())
    return folder


MANY = " ".join(["512 384.25 -1", "17.5 20 9", "3 4 5", "8 9 12"])


@pytest.mark.parametrize("second", [None, "", "  ", "0.5 0.5 -1", MANY, MANY + " " + MANY])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_images_are_read_with_any_second_line(capture, second, newline):
    expected = read_views(capture.write_text())
    found = read_views(_texts(capture, second, newline))
    assert [view.name for view in found] == [view.name for view in expected]
    assert all(np.array_equal(a.viewmat, b.viewmat) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("names", ["{:04d}", "2024 shot {}.png", "{} {} 3.png", "12 {} {}"])
@pytest.mark.parametrize("second", [None, "", MANY])
def test_numeric_image_names_are_not_read_as_points(capture, names, second):
    capture.names = [names.format(i, i) for i in range(12)]
    assert sorted(view.name for view in read_views(_texts(capture, second))) == sorted(capture.names)


def test_unrecognised_line_is_refused(capture):
    with pytest.raises(DatasetError, match="line 4 is not an image"):
        read_views(_texts(capture, "1.5 2.5"))


@pytest.mark.parametrize("photos", ["images", "."])
def test_text_model_is_found_in_the_root_folder(capture, photos):
    for file in capture.write_text().iterdir():
        file.rename(capture.root / file.name)
    capture.write_images(photos)
    dataset = open_dataset(capture.root, split="all")
    assert (dataset.num_views, dataset.points.num_points) == (12, 5)
    assert dataset_layout(capture.root) == "colmap"


def test_points_are_optional(capture):
    folder = capture.write_binary()
    (folder / "points3D.bin").unlink()
    assert read_points(folder) is None


def test_missing_files_are_named(capture):
    folder = capture.write_binary()
    (folder / "cameras.bin").unlink()
    with pytest.raises(DatasetError, match=r"neither cameras\.bin nor cameras\.txt"):
        read_views(folder)


def read_everything(folder):
    return read_views(folder), read_points(folder)


LYING = struct.pack("<Q", 1 << 60)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("cameras.bin", LYING + bytes(60), "promises 1152921504606846976 records"),
        ("images.bin", LYING + bytes(99), "promises"),
        ("points3D.bin", LYING + bytes(99), "promises"),
        ("cameras.bin", b"\1", "ends early"),
        ("cameras.bin", struct.pack("<QIiQQ4d", 1, 7, 99, 4, 4, 1, 1, 1, 1), "unknown model, number 99"),
        ("cameras.bin", struct.pack("<QIiQQ4d", 1, 7, 1, 0, 4, 1, 1, 1, 1), "0 x 4 pixels"),
        ("cameras.bin", struct.pack("<QIiQQ4d", 1, 8, 1, 4, 4, 1, 1, 1, 1), "refers to camera 7"),
        ("images.bin", struct.pack("<Q", 0), "has no images"),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 7) + b"a" * 50, "does not end"),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 7) + b"a\0" + LYING + b"\0" * 9, "promises"),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 7) + b"\xff\0" + bytes(8), "not UTF-8"),
        (
            "images.bin",
            struct.pack("<QI7dI", 1, 1, np.nan, 0, 0, 0, 0, 0, 0, 7) + b"a\0" + bytes(8),
            "'a' is not finite",
        ),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 0, 0, 0, 0, 0, 0, 0, 7) + b"a\0" + bytes(8), "'a' is not finite"),
        ("images.bin", struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 7) + b"a\0" + bytes(9), "1 bytes after"),
    ],
)
def test_damaged_binary_files_are_refused(capture, name, content, reason):
    folder = capture.write_binary()
    (folder / name).write_bytes(content)
    with pytest.raises(DatasetError, match=reason) as caught:
        read_everything(folder)
    assert "sparse" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("cameras.txt", "7 PINHOLE 40", "line 1 is not a camera"),
        ("cameras.txt", "7 PINHOLE 40 24 1 2 3", "PINHOLE with 3 parameters"),
        ("images.txt", "1 1 0 0 zero 0 0 0 7 a.png\n\n", "line 1 is not an image"),
        ("images.txt", "1 1 0 0 0 0 0 0 7\n\n", "line 1 is not an image"),
        ("points3D.txt", "1 0 0 0 300 0 0 0.5", "line 1 is not a point"),
        ("points3D.txt", "1 0 0", "line 1 is not a point"),
        ("points3D.txt", "1 nan 0 0 3 0 0 0.5", "not finite"),
    ],
)
def test_damaged_text_files_are_refused(capture, name, content, reason):
    folder = capture.write_text()
    (folder / name).write_text(content)
    with pytest.raises(DatasetError, match=reason):
        read_everything(folder)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]), cut=st.booleans())
def test_damage_is_one_error_or_finite_views(data, name, cut, capture):
    folder = capture.write_binary()
    raw = bytearray((folder / name).read_bytes())
    at = data.draw(st.integers(0, len(raw) - 1))
    raw[at] ^= data.draw(st.integers(1, 255))
    (folder / name).write_bytes(raw[:at] if cut else raw)
    try:
        views, points = read_views(folder), read_points(folder)
    except DatasetError:
        return
    assert all(np.isfinite(view.viewmat).all() for view in views)
    assert points.num_points == 5


def test_a_byte_order_mark_and_indented_comments_are_skipped(capture):
    folder = capture.write_text()
    before = [view.name for view in read_views(folder)], len(read_points(folder).positions)
    for name in ("cameras", "images", "points3D"):
        path = folder / f"{name}.txt"
        path.write_bytes(b"\xef\xbb\xbf# first\r\n  # indented\n\t#\n" + path.read_bytes() + b"  # last\n")
    assert ([view.name for view in read_views(folder)], len(read_points(folder).positions)) == before
    path = folder / "cameras.txt"
    path.write_bytes(b"\xef\xbb\xbf7 PINHOLE 40 24 33 35 20 12\n")
    assert len(read_views(folder)) == 12


@pytest.mark.parametrize("folders", ["", "Räume/"])
def test_names_of_another_unicode_normal_form_are_found(folders, capture):
    names = [f"{folders}Süd {name}" for name in capture.names]
    capture.names = [unicodedata.normalize("NFD", name) for name in names]
    (capture.root / "images" / unicodedata.normalize("NFD", folders)).mkdir(parents=True)
    capture.write_images()
    capture.names = [unicodedata.normalize("NFC", name) for name in names]
    capture.write_binary()
    dataset = open_dataset(capture.root, split="all")
    assert dataset.num_views == 12
    for view, number in enumerate(capture.sorted_views):
        assert np.array_equal(np.rint(dataset.image(view) * 255), capture.pixels[number])


@pytest.mark.parametrize(("stated", "stored"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_photos_of_another_unicode_normal_form_are_found_without_listing_their_folder(
    stated, stored, tmp_path, monkeypatch
):
    """A list for each photo would take a minute for 10,000 photos."""
    path = tmp_path / unicodedata.normalize(stored, "Süd.jpg")
    path.touch()
    monkeypatch.setattr(os, "listdir", lambda folder: pytest.fail("the folder was listed"))
    assert child(tmp_path, unicodedata.normalize(stated, "Süd.jpg"), tmp_path).samefile(path)


def test_map_coordinates_are_relative_to_one_origin(capture):
    capture.write_images()
    expected = capture.points.copy()
    local = [capture.viewmat(view) for view in range(12)]
    there = np.array([451234.25, 5411876.5, 118.75])
    capture.points = capture.points + there
    capture.translations = np.array([pose[:3, 3] - pose[:3, :3] @ there for pose in local])
    capture.write_binary()
    dataset = open_dataset(capture.root, split="all")
    points = dataset.points.relative_to(tuple(there))
    assert dataset.points.origin == dataset.cameras.origin != (0, 0, 0)
    assert np.abs(points.positions - expected).max() < 1e-5
    cameras = dataset.cameras.relative_to(tuple(there))
    for view, number in enumerate(capture.sorted_views):
        assert np.abs(cameras.viewmats[view] - local[number]).max() < 1e-5


@pytest.mark.parametrize("parent", ["sparse", "colmap/sparse", "."])
def test_the_reconstruction_with_the_lowest_number_is_read(capture, caplog, parent):
    capture.write_images()
    folder = capture.write_binary()
    for number in ("10", "2"):
        shutil.copytree(folder, capture.root / parent / number)
    shutil.rmtree(folder)
    assert find_reconstruction(capture.root) == capture.root / parent / "2"
    assert open_dataset(capture.root).num_views == 2
    folder = "" if parent == "." else f"{parent}/"
    assert f"{folder}2 (12 images) is read; the others are not: {folder}10 (12 images)" in caplog.text


def test_photos_may_be_beside_the_numbered_reconstruction(capture):
    capture.write_images()
    shutil.copytree(capture.write_binary(), capture.root / "0")
    shutil.rmtree(capture.root / "sparse")
    (capture.root / "images").rename(capture.root.parent / "photos")
    shutil.copytree(capture.root.parent / "photos", capture.root, dirs_exist_ok=True)
    assert open_dataset(capture.root, split="all").num_views == 12
    with pytest.raises(DatasetError, match=rf"{re.escape(str(capture.root))} looks like a dataset \(layout: colmap\)"):
        open_dataset(capture.root / "0")


def test_the_dataset_above_a_folder_of_reconstructions_is_named(capture):
    capture.write_images()
    capture.write_binary()
    with pytest.raises(DatasetError, match=rf"{re.escape(str(capture.root))} looks like a dataset \(layout: colmap\)"):
        open_dataset(capture.root / "sparse")


def test_a_folder_for_reconstructions_without_one_is_not_called_a_dataset(capture):
    (capture.root / "sparse").mkdir(parents=True)
    with pytest.raises(DatasetError, match="COLMAP reconstruction") as refusal:
        open_dataset(capture.root)
    assert "looks like" not in str(refusal.value)


def test_photos_in_folders_may_have_another_suffix(capture):
    capture.names = [f"{'left' if i < 6 else 'right'}/{i:02d}.JPG" for i in range(12)]
    capture.write_binary()
    for i, pixels in enumerate(capture.pixels):
        file = (capture.root / "images" / capture.names[i]).with_suffix(".png")
        file.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(file)
    found = open_dataset(capture.root, split="all")
    assert [path.parent.name for path in found.image_paths] == [name.split("/")[0] for name in capture.names]
    assert [path.stem for path in found.image_paths] == [name.split("/")[1].split(".")[0] for name in capture.names]


def test_photos_may_have_names_of_another_letter_case(capture):
    capture.write_images()
    capture.write_binary()
    for file in (capture.root / "images").iterdir():
        file.rename(file.with_name(file.name.upper()))
    found = open_dataset(capture.root, split="all")
    assert [path.name.lower() for path in found.image_paths] == sorted(capture.names)


def test_other_reconstructions_give_a_warning(capture, caplog):
    capture.write_images()
    folder = capture.write_binary()
    open_dataset(capture.root)
    assert not caplog.text
    shutil.copytree(folder, folder.parent / "1")
    open_dataset(capture.root)
    assert "of 2 reconstructions, sparse/0 (12 images) is read; the others are not: sparse/1 (12 images)" in caplog.text


@pytest.mark.parametrize(
    ("read", "other", "message"),
    [
        (".", "sparse/1", "the one in the folder itself (12 images) is read; the others are not: sparse/1 (3 images)"),
        ("sparse", "0", "sparse (12 images) is read; the others are not: 0 (3 images)"),
        ("sparse/0", "sparse", "sparse/0 (12 images) is read; the others are not: sparse (3 images)"),
        ("colmap/sparse/0", ".", "colmap/sparse/0 (12 images) is read; the others are not: the one in the folder "),
    ],
)
def test_a_reconstruction_elsewhere_that_is_not_read_is_named_with_its_images(capture, caplog, read, other, message):
    capture.write_images()
    kept = shutil.move(capture.write_binary(), capture.root.parent / "kept")
    capture.names, capture.quaternions = capture.names[:3], capture.quaternions[:3]
    fewer = capture.write_text()
    shutil.move(fewer, capture.root.parent / "fewer")
    (capture.root / "sparse").rmdir()
    shutil.copytree(kept, capture.root / read, dirs_exist_ok=True)
    shutil.copytree(capture.root.parent / "fewer", capture.root / other, dirs_exist_ok=True)
    assert open_dataset(capture.root, split="all").num_views == 12
    assert message in caplog.text


def test_a_damaged_reconstruction_that_is_not_read_is_named(capture, caplog):
    capture.write_images()
    folder = capture.write_binary()
    shutil.copytree(folder, folder.parent / "1")
    (folder.parent / "1" / "images.bin").write_bytes(b"damaged")
    open_dataset(capture.root)
    assert "the others are not: sparse/1 (cannot be read)" in caplog.text


def test_a_folder_that_cannot_be_searched_for_more_reconstructions_gives_a_warning(capture, caplog, monkeypatch):
    capture.write_images()
    capture.write_binary()
    other, listed = capture.root / "colmap" / "sparse", Path.iterdir
    other.mkdir(parents=True)

    def refuse(path):
        if path == other:
            raise PermissionError(13, "Permission denied", str(path))
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert open_dataset(capture.root, split="all").num_views == 12
    assert f"{other} cannot be searched for more reconstructions: Permission denied" in caplog.text


def test_a_reconstruction_that_two_paths_reach_is_one(capture, caplog):
    capture.write_images()
    folder = capture.write_binary()
    (folder.parent / "1").symlink_to("0")
    open_dataset(capture.root)
    assert not caplog.text


def test_photos_beside_a_numbered_reconstruction_are_posed_photos(capture):
    shutil.copytree(capture.write_binary(), capture.root / "0")
    shutil.rmtree(capture.root / "sparse")
    for name, pixels in zip(capture.names, capture.pixels, strict=True):
        Image.fromarray(pixels).save(capture.root / name)
    assert file_kind(capture.root) == DATASET
    shutil.rmtree(capture.root / "0")
    assert file_kind(capture.root) == PHOTOS


@pytest.mark.parametrize(("name", "what", "count"), [("images", "images", 12), ("points3D", "points", 5)])
def test_a_text_model_with_fewer_entries_than_its_header_states_gives_a_warning(name, what, count, capture, caplog):
    folder = capture.write_text()
    rows = (folder / f"{name}.txt").read_text()
    for stated in (count, count + 1):
        (folder / f"{name}.txt").write_text(f"# Number of {what}: {stated}, mean of something: 3\n{rows}")
        assert len(read_views(folder)) == 12
        assert read_points(folder).num_points == 5
        assert (f"has {count} entries, and its header states {stated}: the file may be cut" in caplog.text) == (
            stated != count
        )


def test_a_camera_that_is_there_twice_is_refused(capture):
    folder = capture.write_text()
    with (folder / "cameras.txt").open("a") as file:
        file.write("7 PINHOLE 40 24 90 90 20 12\n")
    with pytest.raises(DatasetError, match="camera 7 is there twice"):
        read_views(folder)


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("cameras.txt", lambda text: text.replace(" 40 24 ", " 40 25 ")),
        ("images.txt", lambda text: "\n".join(text.splitlines()[:-2])),
        ("images.txt", lambda text: text.replace("\n1 ", "\n1 -")),
    ],
)
def test_text_files_that_disagree_with_binary_ones_give_a_warning(file, change, capture, caplog):
    folder = capture.write_binary("PINHOLE", (*capture.focal, 20.0, 12.0))
    capture.write_text()
    read_views(folder)
    assert not caplog.messages
    (folder / file).write_text(change((folder / file).read_text()))
    views = read_views(folder)
    assert len(views) == 12
    assert f"{folder}: its .bin files, which are read, have 12 views, its .txt files" in caplog.text
    (folder / file).write_text("damaged")
    read_views(folder)
    assert "its .txt files are damaged" in caplog.text


@pytest.mark.parametrize("form", ["binary", "text"])
def test_the_images_of_other_reconstructions_are_counted_without_reading_them(capture, caplog, monkeypatch, form):
    capture.write_images()
    folder = getattr(capture, f"write_{form}")()
    if form == "text":
        rows = (folder / "images.txt").read_text()
        (folder / "images.txt").write_text(f"# Number of images: 12, mean observations per image: 1\n{rows}")
    shutil.copytree(folder, folder.parent / "1")
    module, read = {"binary": _colmap_binary, "text": _colmap_text}[form], []
    original = module.read_images
    monkeypatch.setattr(module, "read_images", lambda path: read.append(path) or original(path))
    open_dataset(capture.root)
    assert "sparse/0 (12 images) is read; the others are not: sparse/1 (12 images)" in caplog.text
    assert [path.parent for path in read] == [folder]
