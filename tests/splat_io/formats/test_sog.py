"""SOG of version 1, archives with nested folders, and streamed SOG as bundles and with several degrees."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from close import assert_close
from splat_io.formats.handmade import some_splats
from splatwire.errors import DatasetError
from splatwire.io.formats import is_antialiased, read_splats, splats_kind, write_splats
from splatwire.types.splats import Splats


def _picture(pixels: np.ndarray, width: int | None = None) -> bytes:
    count = len(pixels)
    width = width or -(-int(np.ceil(np.sqrt(count))) // 4) * 4
    rows = np.zeros((-(-count // width) * width, 4), np.uint8)
    rows[:, 3] = 255
    rows[:count, : pixels.shape[1]] = pixels
    file = io.BytesIO()
    Image.fromarray(rows.reshape(-1, width, 4)).save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def _shares(values: np.ndarray, top: int = 255) -> tuple[np.ndarray, dict[str, Any]]:
    low, high = values.min(axis=0), values.max(axis=0)
    return np.rint((values - low) / (high - low) * top), {"mins": low.tolist(), "maxs": high.tolist()}


def first_version(splats: Splats, palette: int = 0) -> dict[str, bytes]:
    """Files of a SOG of version 1; `palette` is the number of different harmonics."""
    count, means = splats.num_gaussians, splats.means.astype(np.float64)
    codes, bounds = _shares(np.sign(means) * np.log1p(np.abs(means)), 65535)
    codes = codes.astype(int)
    quats = splats.quats
    largest = np.abs(quats).argmax(axis=1)
    quats = quats * np.sign(quats[np.arange(count), largest])[:, None]
    rest = np.stack([np.delete(row, axis) for row, axis in zip(quats, largest, strict=True)])
    turns = np.concatenate([np.rint((rest * 2**0.5 + 1) / 2 * 255), 252 + largest[:, None]], axis=1)
    scales, scale_bounds = _shares(np.log(splats.scales))
    opacities = splats.opacities.astype(np.float64)
    colors, color_bounds = _shares(np.c_[splats.sh[:, 0], np.log(opacities / (1 - opacities))])
    files = {
        "means_l.webp": _picture(codes & 255), "means_u.webp": _picture(codes >> 8), "quats.webp": _picture(turns),
        "scales.webp": _picture(scales), "sh0.webp": _picture(colors),
    }  # fmt: skip
    meta: dict[str, Any] = {
        "means": {"shape": [count, 3], "dtype": "float32", **bounds, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"shape": [count, 3], "dtype": "float32", **scale_bounds, "files": ["scales.webp"]},
        "quats": {"shape": [count, 4], "encoding": "quaternion_packed", "files": ["quats.webp"]},
        "sh0": {"shape": [count, 1, 4], "dtype": "float32", **color_bounds, "files": ["sh0.webp"]},
    }
    if palette:
        width = splats.sh.shape[1] - 1
        entries = splats.sh[:palette, 1:]
        low, high = float(entries.min()), float(entries.max())
        rows = np.zeros((-(-palette // 64) * 64, width, 3))
        rows[:palette] = np.rint((entries - low) / (high - low) * 255)
        label = np.arange(count) % palette
        files["shN_centroids.webp"] = _picture(rows.reshape(-1, 3), 64 * width)
        files["shN_labels.webp"] = _picture(np.stack([label & 255, label >> 8, 0 * label], axis=1))
        meta["shN"] = {"mins": low, "maxs": high, "files": ["shN_centroids.webp", "shN_labels.webp"]}
    return files | {"meta.json": json.dumps(meta).encode()}


def _archive(path: Path, files: dict[str, bytes], prefix: str = "") -> Path:
    with zipfile.ZipFile(path, "w") as bundle:
        for name, data in files.items():
            bundle.writestr(prefix + name, data)
    return path


@pytest.mark.parametrize(("degree", "palette"), [(0, 0), (1, 70), (2, 5), (3, 300)])
def test_version_1_is_read(degree: int, palette: int, tmp_path: Path) -> None:
    splats = some_splats(300, degree)
    if palette:
        splats.sh[:, 1:] = splats.sh[np.arange(300) % palette, 1:]
    found = read_splats(_archive(tmp_path / "a.sog", first_version(splats, palette)))
    assert_close(found.means, splats.means, atol=3e-4, rtol=0)
    assert_close(np.log(found.scales), np.log(splats.scales), atol=0.02, rtol=0)
    assert_close(found.opacities, splats.opacities, atol=0.01, rtol=0)
    assert_close(found.sh, splats.sh, atol=0.01, rtol=0)
    signs = np.sign((found.quats * splats.quats).sum(axis=1, keepdims=True))
    assert_close(found.quats * signs, splats.quats, atol=0.01, rtol=0)


@pytest.mark.parametrize(
    ("section", "change", "reason"),
    [
        ("means", {"shape": ["x"]}, "count is 'x'"),
        ("means", {"shape": None}, "count is None"),
        ("scales", {"mins": [0, 0]}, "scales.mins is not 3 numbers"),
        ("sh0", {"maxs": [0, 0, 0]}, "sh0.maxs is not 4 numbers"),
        ("shN", {"mins": [0]}, "shN.mins is not 1 numbers"),
        ("shN", {"files": ["sh0.webp", "shN_labels.webp"]}, "names sh0.webp twice"),
        ("shN", {"files": ["meta.json", "shN_labels.webp"]}, "is no WebP picture"),
    ],
)
def test_damage_of_version_1_is_named(section: str, change: dict[str, Any], reason: str, tmp_path: Path) -> None:
    files = first_version(some_splats(300, 1), 70)
    meta = json.loads(files["meta.json"])
    meta[section] |= change
    path = _archive(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta).encode()})
    with pytest.raises(DatasetError, match=reason):
        read_splats(path)


def _files(path: Path, splats: Splats, *, antialiased: bool = False) -> dict[str, bytes]:
    write_splats([splats], path, antialiased=antialiased)
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


@pytest.mark.parametrize("prefix", ["scene/", "exports/my scene/"])
def test_archive_with_a_nested_folder_is_read(prefix: str, tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 1), antialiased=True)
    path = _archive(tmp_path / "b.zip", files, prefix)
    with zipfile.ZipFile(path, "a") as bundle:  # as macOS packs
        bundle.writestr(f"__MACOSX/{prefix}meta.json", b"\0")
        bundle.writestr(".DS_Store", b"\0")
    assert splats_kind(path) == "sog"
    assert is_antialiased(path)
    for name, values in vars(read_splats(tmp_path / "a.sog")).items():
        assert np.array_equal(getattr(read_splats(path), name), values)


def _named(files: dict[str, bytes], rename: Callable[[str], str]) -> dict[str, bytes]:
    """Renames the images of a SOG in its `meta.json` only."""
    meta = json.loads(files["meta.json"])
    for section in meta.values():
        if isinstance(section, dict) and "files" in section:
            section["files"] = [rename(name) for name in section["files"]]
    return {**files, "meta.json": json.dumps(meta).encode()}


def _moved(files: dict[str, bytes], folder: str) -> dict[str, bytes]:
    return {name if name == "meta.json" else f"{folder}{name}": data for name, data in files.items()}


def _folder(path: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)
    return path


@pytest.mark.parametrize("stated", ["images/", "./images/", "images\\", "images/./"])
@pytest.mark.parametrize("form", ["folder", "meta.json", "archive", "nested archive", "archive of Windows"])
def test_images_in_a_subfolder_are_read(stated: str, form: str, tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 1))
    named = _moved(_named(files, lambda name: stated + name), "images/")
    if form == "archive of Windows":
        path = _archive(tmp_path / "b.sog", {name.replace("/", "\\"): data for name, data in named.items()}, "x\\")
    elif "archive" in form:
        path = _archive(tmp_path / "b.sog", named, "" if form == "archive" else "x/y/")
    else:
        path = _folder(tmp_path / "b", named) / ("" if form == "folder" else "meta.json")
    expected = read_splats(tmp_path / "a.sog")
    for name, values in vars(expected).items():
        assert np.array_equal(getattr(read_splats(path), name), values)


@pytest.mark.parametrize("stated", ["../b/", "images/../../b/", "/b/", "C:\\b\\", "..\\b\\"])
@pytest.mark.parametrize("archived", [False, True])
def test_images_outside_the_folder_are_refused(stated: str, archived: bool, tmp_path: Path) -> None:
    files = _named(_files(tmp_path / "a.sog", some_splats(70, 0)), lambda name: stated + name)
    path = _archive(tmp_path / "b.zip", files, "b/") if archived else _folder(tmp_path / "b", files)
    with pytest.raises(DatasetError, match="which is no file in its folder or below"):
        read_splats(path)


def test_links_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    _folder(tmp_path / "other/images", files)
    named = _named(files, lambda name: f"images/{name}")
    path = _folder(tmp_path / "b", {"meta.json": named["meta.json"]})
    (path / "images").symlink_to(tmp_path / "other/images")
    with pytest.raises(DatasetError, match="is a link out of its folder"):
        read_splats(path)


def test_members_of_one_path_are_refused(tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    path = _archive(tmp_path / "b.sog", {**files, "./means_l.webp": files["means_u.webp"]})
    with pytest.raises(DatasetError, match=r"two members 'means_l\.webp'"):
        read_splats(path)


def test_chunks_with_images_in_subfolders_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of Gaussians is compared with the size of the images in subfolders, too."""
    monkeypatch.setattr("splatwire.io.formats._columns.FREE_GAUSSIANS", 1000)
    count = 1001
    files = _files(tmp_path / "a.sog", some_splats(count, 0))
    _folder(tmp_path / "s/0_0", _moved(_named(files, lambda name: f"images/{name}"), "images/"))
    tree = {"lods": {"0": {"file": 0, "offset": 0, "count": count}}}
    (tmp_path / "s/lod-meta.json").write_text(json.dumps({"filenames": ["0_0/meta.json"], "tree": tree}))
    assert read_splats(tmp_path / "s").num_gaussians == count


def test_archive_of_several_scenes_is_refused_with_a_reason(tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    path = _archive(tmp_path / "b.sog", {f"{n}/{name}": data for n in range(2) for name, data in files.items()})
    with pytest.raises(DatasetError, match=r"2 folders in it have a meta\.json: unpack it"):
        read_splats(path)


def test_archive_of_a_streamed_sog_is_refused_with_a_reason(tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    path = _archive(tmp_path / "b.sog", {"x/lod-meta.json": b"{}", **{f"x/0_0/{n}": d for n, d in files.items()}})
    with pytest.raises(DatasetError, match=r"streamed SOG .*unpack it"):
        read_splats(path)


def test_an_archive_without_meta_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"meta\.json is missing"):
        read_splats(_archive(tmp_path / "a.sog", {"readme.txt": b""}))


def _streamed(folder: Path, degrees: dict[str, int], environment: str, count: int = 40) -> Path:
    """A streamed SOG with one chunk per degree."""
    names = list(degrees)
    for seed, (name, degree) in enumerate(degrees.items()):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        bundle = target if target.suffix == ".sog" else folder / "chunk.sog"
        write_splats([some_splats(count, degree, seed)], bundle)
        if bundle != target:
            with zipfile.ZipFile(bundle) as archive:
                archive.extractall(target.parent)
            bundle.unlink()
    chunks = [name for name in names if name != environment]
    leaves = [{"lods": {"0": {"file": file, "offset": 0, "count": count}}} for file in range(len(chunks))]
    content = {"filenames": chunks, "environment": environment or None, "tree": {"children": leaves}}
    (folder / "lod-meta.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("environment", ["environment/meta.json", "environment/environment.sog", ""])
@pytest.mark.parametrize("chunk", ["0_0/meta.json", "0_0.sog", "0_0/chunk.SOG"])
def test_bundled_chunks_and_environment_are_read(environment: str, chunk: str, tmp_path: Path) -> None:
    degrees = {chunk.replace(".SOG", ".sog"): 0} | ({environment: 0} if environment else {})
    found = read_splats(_streamed(tmp_path, degrees, environment))
    assert found.num_gaussians == 40 * len(degrees)
    expected = [name if name.endswith(".sog") else str(Path(name).parent) for name in degrees]
    assert_close(found.means, np.concatenate([read_splats(tmp_path / name).means for name in expected]))


@pytest.mark.parametrize("order", [(0, 2, 1), (3, 0, 1), (1, 1, 2)])
def test_chunks_of_different_degrees_keep_their_colours(order: tuple[int, ...], tmp_path: Path) -> None:
    degrees = {f"{n}_0.sog": degree for n, degree in enumerate(order)}
    found = read_splats(_streamed(tmp_path, degrees, ""))
    assert found.degree == max(order)
    for n, degree in enumerate(order):
        part, own = read_splats(tmp_path / f"{n}_0.sog"), found.slice_range(40 * n, 40 * (n + 1))
        assert np.array_equal(own.means, part.means)
        assert np.array_equal(own.sh[:, : (degree + 1) ** 2], part.sh)
        assert not own.sh[:, (degree + 1) ** 2 :].any()


def test_missing_environment_gives_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _streamed(tmp_path, {"0_0.sog": 0, "environment/environment.sog": 0}, "environment/environment.sog")
    (tmp_path / "environment" / "environment.sog").unlink()
    assert read_splats(tmp_path).num_gaussians == 40
    assert "environment.sog" in caplog.text


def test_a_palette_of_another_name_short_code_books_and_white_padding_are_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 1))
    expected = read_splats(tmp_path / "a.sog")
    meta = json.loads(files["meta.json"]) | {"width": 12, "height": 8}
    meta["shN"]["palette_size"] = meta["shN"].pop("count")
    meta["shN"]["coeffs"] = 3
    for section in ("scales", "sh0", "shN"):
        meta[section]["codebook"] = sorted(set(meta[section]["codebook"]))
    assert len(meta["sh0"]["codebook"]) < 256
    image = Image.open(io.BytesIO(files["quats.webp"]))
    pixels = np.asarray(image.convert("RGBA")).reshape(-1, 4).copy()
    pixels[70:] = 255
    files |= {"meta.json": json.dumps(meta).encode(), "quats.webp": _picture(pixels, image.width)}
    found = read_splats(_archive(tmp_path / "b.sog", files))
    for name, values in vars(expected).items():
        assert np.array_equal(getattr(found, name), values), name
    assert not caplog.text
    meta["sh0"]["codebook"] = meta["sh0"]["codebook"][:-1]
    assert (
        read_splats(_archive(tmp_path / "c.sog", files | {"meta.json": json.dumps(meta).encode()})).num_gaussians < 70
    )
    assert "cannot be drawn" in caplog.text


@pytest.mark.parametrize(("section", "other"), [("means", "means"), ("quats", "scales"), ("sh0", "quats")])
def test_a_picture_that_is_named_twice_is_refused(section: str, other: str, tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    meta = json.loads(files["meta.json"])
    meta[section]["files"][-1] = meta[other]["files"][0]
    with pytest.raises(DatasetError, match=r"names \w+.webp twice"):
        read_splats(_archive(tmp_path / "b.sog", files | {"meta.json": json.dumps(meta).encode()}))


@pytest.mark.parametrize(("flag", "expected"), [(1, True), (0, False), (True, True), (None, False), ("yes", False)])
def test_an_antialias_flag_may_be_a_number(
    flag: object, expected: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    files["meta.json"] = json.dumps({**json.loads(files["meta.json"]), "antialias": flag}).encode()
    assert is_antialiased(_archive(tmp_path / "b.sog", files)) is expected
    assert ("antialias 'yes' is not a boolean" in caplog.text) == (flag == "yes")


def test_the_antialiasing_flag_has_both_names_when_written(tmp_path: Path) -> None:
    meta = json.loads(_files(tmp_path / "a.sog", some_splats(70, 0), antialiased=True)["meta.json"])
    assert (meta["antialias"], meta["model"]) == (True, "antialiased")
    assert "model" not in json.loads(_files(tmp_path / "a.sog", some_splats(70, 0))["meta.json"])


@pytest.mark.parametrize(
    "fields",
    [
        {"antialiased": True},
        {"SplatRenderMode": "mip"},
        {"asset": {"extras": {"aa": 1}}},
        {"model": "antialiased"},
    ],
)
def test_antialiasing_under_another_name_is_read(fields: dict[str, object], tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(70, 0))
    meta = json.loads(files["meta.json"])
    meta.pop("antialias", None)
    files["meta.json"] = json.dumps(meta).encode()
    assert not is_antialiased(_archive(tmp_path / "b.sog", files))
    files["meta.json"] = json.dumps(meta | fields).encode()
    assert is_antialiased(_archive(tmp_path / "c.sog", files))


def test_a_zip_of_other_files_is_refused_with_its_content(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as bundle:
        bundle.writestr("scene.ply", b"ply")
    with pytest.raises(
        DatasetError, match=r"meta\.json is missing, so this zip is no SOG, its first file is 'scene\.ply'"
    ):
        read_splats(tmp_path / "a.zip")


def members(folder: Path) -> dict[str, bytes]:
    """Files of a SOG."""
    write_splats([some_splats(300, 1)], folder / "base.sog")
    with zipfile.ZipFile(folder / "base.sog") as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


@pytest.mark.parametrize("name", ["means_l.webp", "quats.webp", "shN_labels.webp"])
def test_lossy_images_give_a_warning(name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = members(tmp_path)
    read_splats(_archive(tmp_path / "a.sog", files))
    assert not caplog.messages
    lossy = io.BytesIO()
    with Image.open(io.BytesIO(files[name])) as image:
        image.save(lossy, "WEBP", quality=90)
    read_splats(_archive(tmp_path / "b.sog", files | {name: lossy.getvalue()}))
    assert f"b.sog: {name} is a lossy WebP, and SOG needs lossless ones" in caplog.text


def test_a_member_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    path = _archive(tmp_path / "a.sog", members(tmp_path))
    with zipfile.ZipFile(path, "a") as bundle, pytest.warns(UserWarning, match="Duplicate name"):
        bundle.writestr("meta.json", b"{}")
    with pytest.raises(DatasetError, match=r"a\.sog: the zip has two members 'meta\.json'"):
        read_splats(path)


def test_swapped_bounds_of_positions_are_refused(tmp_path: Path) -> None:
    files = members(tmp_path)
    meta = json.loads(files["meta.json"])
    meta["means"]["mins"], meta["means"]["maxs"] = meta["means"]["maxs"], meta["means"]["mins"]
    path = _archive(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta).encode()})
    with pytest.raises(DatasetError, match=r"a number of means\.mins is above that of means\.maxs"):
        read_splats(path)


@pytest.mark.parametrize(
    ("field", "value", "meaning"),
    [
        ("origin", [451234.5, 5411876, 118], "a shift of the positions"),
        ("offset", {"x": 4000, "y": 2500, "z": 0}, "a shift of the positions"),
        ("unit", "cm", "the unit of the positions"),
        ("sceneScale", 0.01, "a scale of the positions"),
        ("crs", "EPSG:25832", "the coordinate reference system of the positions"),
        ("upAxis", "z", "the axis that is up"),
    ],
)
@pytest.mark.parametrize("place", ["meta", "extras"])
def test_unapplied_placement_fields_give_a_warning(
    place: str, field: str, value: Any, meaning: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = members(tmp_path)
    meta = json.loads(files["meta.json"])
    asset = {"generator": "splat-transform v1.10.2", "extras": {"title": "scale 3"}}
    read_splats(_archive(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta | {"asset": asset}).encode()}))
    assert not caplog.messages
    asset["extras"] |= {field: value} if place == "extras" else {}
    meta |= {"asset": asset} | ({field: value} if place == "meta" else {})
    read_splats(_archive(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta).encode()}))
    assert f"a.sog: field '{field}: " in caplog.text
    assert f"may be {meaning}: it is left out" in caplog.text


def test_unknown_sections_and_fields_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = members(tmp_path)
    meta = json.loads(files["meta.json"])
    meta["quats"]["encoding"] = "octahedral"
    meta["motion"] = {"files": ["motion.webp"]}
    read_splats(_archive(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta).encode()}))
    assert "motion, quats.encoding of meta.json are not known" in caplog.text


def test_a_cut_archive_is_named_as_cut(tmp_path: Path) -> None:
    write_splats([some_splats(40, 0)], tmp_path / "a.sog")
    data = (tmp_path / "a.sog").read_bytes()
    (tmp_path / "b.sog").write_bytes(data[: len(data) // 2])
    with pytest.raises(DatasetError, match=f"the zip is cut after {len(data) // 2:,} bytes"):
        read_splats(tmp_path / "b.sog")


def _changed(files: dict[str, bytes], path: Path, change: dict[str, Any]) -> Path:
    return _archive(path, files | {"meta.json": json.dumps(json.loads(files["meta.json"]) | change).encode()})


def test_a_count_below_the_pixels_gives_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = _files(tmp_path / "a.sog", some_splats(300, 1))
    read_splats(tmp_path / "a.sog")
    assert not caplog.messages
    assert read_splats(_changed(files, tmp_path / "b.sog", {"count": 290})).num_gaussians == 290
    assert "its images have values of 10 more Gaussians than the 290 of meta.json" in caplog.text


def test_colours_of_transparent_pixels_are_no_gaussians(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As in files of splat-transform: its WebP images have other colours in pixels after the last Gaussian."""
    files, changed = _files(tmp_path / "a.sog", some_splats(300, 1)), io.BytesIO()
    pixels = np.array(Image.open(io.BytesIO(files["quats.webp"])).convert("RGBA"))
    pixels.reshape(-1, 4)[300:] = 112, 140, 127, 0
    assert pixels.size > 300 * 4
    Image.fromarray(pixels).save(changed, "WEBP", lossless=True, exact=True)
    read_splats(_archive(tmp_path / "b.sog", files | {"quats.webp": changed.getvalue()}))
    assert not caplog.messages


def test_images_of_different_widths_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Players use the columns and rows of one image for all of them."""
    files, changed = _files(tmp_path / "a.sog", some_splats(300, 1)), io.BytesIO()
    pixels = np.array(Image.open(io.BytesIO(files["scales.webp"])).convert("RGBA"))
    Image.fromarray(np.pad(pixels, ((0, 0), (0, 4), (0, 0)))).save(changed, "WEBP", lossless=True, exact=True)
    read_splats(_archive(tmp_path / "b.sog", files))
    assert not caplog.messages
    read_splats(_archive(tmp_path / "c.sog", files | {"scales.webp": changed.getvalue()}))
    assert "its images have different widths" in caplog.text


def test_an_animation_is_no_image_of_a_sog(tmp_path: Path) -> None:
    files = _files(tmp_path / "a.sog", some_splats(300, 1))
    still = Image.open(io.BytesIO(files["scales.webp"])).convert("RGBA")
    other, moving = Image.fromarray(255 - np.asarray(still)), io.BytesIO()
    still.save(moving, "WEBP", save_all=True, append_images=[other], lossless=True, exact=True)
    with pytest.raises(DatasetError, match=r"scales\.webp is an animation"):
        read_splats(_archive(tmp_path / "b.sog", files | {"scales.webp": moving.getvalue()}))


def test_rotations_without_alpha_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    files, opaque = _files(tmp_path / "a.sog", some_splats(300, 1)), io.BytesIO()
    image = Image.open(io.BytesIO(files["quats.webp"])).convert("RGB")
    image.save(opaque, "WEBP", lossless=True, exact=True)
    read_splats(_archive(tmp_path / "b.sog", files | {"quats.webp": opaque.getvalue()}))
    assert "quats.webp has no alpha channel" in caplog.text
