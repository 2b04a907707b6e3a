import dataclasses
import errno
import json
import os
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from splatwire.anchors import tensor_file
from splatwire.anchors.safetensors_file import open_tensor_file
from splatwire.anchors.scene_file import load_partial, load_scene, save_partial, save_scene
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.types import Prior, TierSizes


def leaves(value, path=""):
    """Every tensor, number and string of nested dataclasses, by path."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from leaves(getattr(value, field.name), f"{path}.{field.name}")
    elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
        for i, item in enumerate(value):
            yield from leaves(item, f"{path}.{i}")
    else:
        yield path, value


def assert_same(a, b):
    left, right = dict(leaves(a)), dict(leaves(b))
    assert left.keys() == right.keys()
    for path, value in left.items():
        if isinstance(value, np.ndarray):
            assert value.dtype == right[path].dtype, path
            assert np.array_equal(value, right[path]), path
        else:
            assert value == right[path], path


def edited(path, change):
    """Rewrites a scene file after `change(tensors, header)`."""
    raw = path.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    header = json.loads(json.loads(raw[8 : 8 + length])["__metadata__"]["splatwire"])
    tensors = load_file(path)
    change(tensors, header)
    save_file(tensors, path, metadata={"splatwire": json.dumps(header)})


def test_scene_round_trips_bit_identically(tiny_scene, tmp_path):
    save_scene(tiny_scene, tmp_path / "a.scene")
    assert_same(load_scene(tmp_path / "a.scene"), tiny_scene)
    assert [file.name for file in tmp_path.iterdir()] == ["a.scene"]


def test_render_hints_round_trip(tiny_scene, tiny_hints, tmp_path):
    for opacity_gain in (None, np.linspace(0, 1, 7, dtype=np.float32)):
        hints = dataclasses.replace(tiny_hints, opacity_gain=opacity_gain)
        scene = dataclasses.replace(tiny_scene, hints=hints)
        save_scene(scene, tmp_path / "a.scene")
        loaded = load_scene(tmp_path / "a.scene")
        assert_same(loaded, scene)
        assert (loaded.hints.opacity_gain is None) == (opacity_gain is None)


def test_background_round_trips_and_black_is_not_stored(tiny_scene, tiny_partial, tmp_path):
    save_scene(tiny_scene, tmp_path / "black")
    assert b"background" not in (tmp_path / "black").read_bytes()
    assert load_scene(tmp_path / "black").background == (0.0, 0.0, 0.0)
    color = (1.0, 0.1, 0.25)
    save_scene(dataclasses.replace(tiny_scene, background=color), tmp_path / "scene")
    save_partial(
        dataclasses.replace(tiny_partial, scene=dataclasses.replace(tiny_scene, background=color)), tmp_path / "partial"
    )
    assert load_scene(tmp_path / "scene").background == color
    assert load_partial(tmp_path / "partial").scene.background == color


def test_partial_scene_round_trips_bit_identically(tiny_partial, tmp_path):
    save_partial(tiny_partial, tmp_path / "a.part")
    assert_same(load_partial(tmp_path / "a.part"), tiny_partial)


def test_tier_sizes_round_trip(tiny_partial, tmp_path):
    save_partial(tiny_partial, tmp_path / "none")
    assert load_partial(tmp_path / "none").tier_sizes is None
    with_sizes = tiny_partial.with_records(TierSizes(np.linspace(1e-3, 1, 7, dtype=np.float32)))
    save_partial(with_sizes, tmp_path / "with_sizes")
    assert np.array_equal(load_partial(tmp_path / "with_sizes").tier_sizes, with_sizes.tier_sizes)
    save_partial(tiny_partial.with_records(TierSizes(np.linspace(0, 1, 7, dtype=np.float32))), tmp_path / "damaged")
    with pytest.raises(BitstreamError, match=r"'anchors\.tier_sizes' has a size"):
        load_partial(tmp_path / "damaged")
    with pytest.raises(ValueError, match="different numbers of elements"):
        tiny_partial.with_records(TierSizes(np.ones(6, np.float32)))


def test_empty_scene_round_trips(tiny_scene, tmp_path):
    scene = dataclasses.replace(tiny_scene, anchors=tiny_scene.anchors.select(np.zeros(7, np.bool_)))
    save_scene(scene, tmp_path / "a.scene")
    assert_same(load_scene(tmp_path / "a.scene"), scene)


def test_the_same_scene_gives_the_same_bytes(tiny_scene, tmp_path):
    for name in "abcd":
        save_scene(tiny_scene, tmp_path / name)
    assert len({(tmp_path / name).read_bytes() for name in "abcd"}) == 1


def test_the_layout_of_the_file_is_pinned(tiny_scene, tmp_path):
    save_scene(tiny_scene, tmp_path / "a.scene")
    raw = (tmp_path / "a.scene").read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    index = json.loads(raw[8 : 8 + length])
    header = json.loads(index.pop("__metadata__")["splatwire"])
    assert header["format"] == "splatwire-scene"
    assert header["version"] == 1
    assert header["voxel_size"] == "0x1.a9fbe76c8b439p-7"
    shapes = {name: (entry["dtype"], entry["shape"]) for name, entry in index.items()}
    assert shapes["anchors.positions"] == ("F32", [7, 3])
    assert shapes["anchors.mask"] == ("BOOL", [7, 3])
    assert shapes["grid.volume_bits"] == ("U8", [(216 + 256 + 256) * 2 // 8])
    assert shapes["grid.planes_bits"] == ("U8", [3 * (88 + 512) * 2 // 8])
    assert shapes["context.channel.1.hidden.weight"] == ("F32", [4, 17])
    begin, end = index["grid.volume_bits"]["data_offsets"]
    bits = np.unpackbits(np.frombuffer(raw[8 + length + begin : 8 + length + end], dtype=np.uint8))
    assert (bits * 2.0 - 1 == tiny_scene.coding.context_model.grid.volume.flatten()).all()


def test_scene_file_has_default_permissions(tiny_scene, tmp_path):
    save_scene(tiny_scene, tmp_path / "scene")
    (tmp_path / "other").touch()
    assert (tmp_path / "scene").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_a_failed_write_leaves_the_old_file(tiny_scene, tmp_path, monkeypatch):
    path = tmp_path / "a.scene"
    path.write_bytes(b"old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        save_scene(tiny_scene, path)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.scene"]


def test_scene_and_partial_scene_are_distinguished(tiny_scene, tiny_partial, tmp_path):
    save_scene(tiny_scene, tmp_path / "a")
    save_partial(tiny_partial, tmp_path / "b")
    with pytest.raises(BitstreamError, match="conceal it first"):
        load_scene(tmp_path / "b")
    with pytest.raises(BitstreamError, match="not a 'partial' scene"):
        load_partial(tmp_path / "a")


def test_a_full_disk_is_described_by_safetensors_where_errors_have_other_numbers(tmp_path, monkeypatch):
    def full(*arguments: object, **options: object) -> None:
        raise SafetensorError("There is not enough space on the disk. (os error 112)")

    monkeypatch.setattr(tensor_file, "save_file", full)
    monkeypatch.setattr(tensor_file, "_HAS_ERRNO", False)
    with pytest.raises(OSError, match=r"a\.scene: cannot be written: There is not enough space") as failed:
        tensor_file.write_tensors({"a": np.zeros(3)}, {}, tmp_path / "a.scene")
    assert failed.value.errno is None


def test_other_version_is_refused_by_name(tiny_scene, tmp_path):
    save_scene(tiny_scene, tmp_path / "a")
    edited(tmp_path / "a", lambda tensors, header: header.update(version=2))
    with pytest.raises(UnsupportedVersionError, match="version 2, this release reads 1"):
        load_scene(tmp_path / "a")


def drop(name):
    return lambda tensors, header: tensors.pop(name)


def put(name, change):
    return lambda tensors, header: tensors.update({name: change(tensors[name])})


def head(**values):
    return lambda tensors, header: header.update(values)


def config(section, **values):
    return lambda tensors, header: header["config"][section].update(values)


def nan_of(value):
    value = value.copy()
    value.reshape(-1)[0] = float("nan")
    return value


BAD = {
    "missing tensor": (drop("anchors.mask"), "'anchors.mask' is missing"),
    "missing positions": (drop("anchors.positions"), "'anchors.positions' is missing"),
    "extra tensor": (lambda t, h: t.update(extra=np.zeros(1, np.float32)), "unexpected tensor 'extra'"),
    "short features": (put("anchors.features", lambda v: v[:6].copy()), r"expected F32 \(7, 5\)"),
    "double features": (put("anchors.features", lambda v: v.astype(np.float64)), "is F64"),
    "nan feature": (put("anchors.features", nan_of), "'anchors.features' is not finite"),
    "nan weight": (put("heads.color.output.bias", nan_of), "'heads.color.output.bias' is not finite"),
    "mask as bytes": (put("anchors.mask", lambda v: v.astype(np.uint8)), "expected BOOL"),
    "scalar positions": (put("anchors.positions", lambda v: np.array(v[0, 0])), "single number"),
    "off the grid": (put("anchors.positions", lambda v: v + 0.004), "not whole multiples"),
    "empty box": (put("grid.bounds_max", lambda v: v * 0 - 9), "not below"),
    "short bits": (put("grid.volume_bits", lambda v: v[1:].copy()), "grid.volume_bits"),
    "wide prior": (put("context.prior.output.bias", lambda v: np.zeros(99, np.float32)), "context.prior.output"),
    "zero voxel": (head(voxel_size="0x0p+0"), "voxel size"),
    "text voxel": (head(voxel_size="big"), "voxel size"),
    "other format": (head(format="other"), "not a scene file"),
    "no slopes": (head(negative_slopes={}), "slope"),
    "slopes as list": (head(negative_slopes=[]), "slope"),
    "config as list": (head(config=[]), "bad configuration"),
    "hints promised": (head(hints=True), "hints.left_out"),
    "huge table": (config("grid", log2_rows_3d=60), "bad configuration"),
    "huge groups": (config("layout", feature_groups=[2] * 65), "bad configuration"),
    "no colour": (head(background=[0, 2, 0]), "background"),
    "colour as text": (head(background="red"), "background"),
    "float size": (config("layout", feature_dim=5.0), "bad configuration"),
    "wrong sum": (config("layout", feature_groups=[2, 4]), "bad configuration"),
    "unknown entry": (config("layout", colour=3), "bad configuration"),
    "other offsets": (config("layout", num_offsets=4), "anchors.offsets"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_file_is_refused_with_its_name_and_the_reason(name, tiny_scene, tmp_path):
    change, reason = BAD[name]
    save_scene(tiny_scene, tmp_path / "a.scene")
    edited(tmp_path / "a.scene", change)
    with pytest.raises(BitstreamError, match=reason) as caught:
        load_scene(tmp_path / "a.scene")
    assert "a.scene" in str(caught.value)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text").write_text("hello")
    save_file({"a": np.zeros(1, np.float32)}, tmp_path / "foreign")
    for name in ("absent", "text", "foreign", "."):
        with pytest.raises(BitstreamError):
            load_scene(tmp_path / name)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_one_error_or_a_finite_scene(data, tiny_scene, tmp_path):
    path = tmp_path / "a.scene"
    save_scene(tiny_scene, path)
    raw = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        raw = raw[: data.draw(st.integers(0, len(raw) - 1))]
    else:
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(raw)
    try:
        scene = load_scene(path)
    except BitstreamError:
        return
    assert all(np.isfinite(value).all() for _, value in leaves(scene) if isinstance(value, np.ndarray))
    layout, anchors = scene.coding.config.layout, scene.anchors
    assert (anchors.features.shape[1], anchors.mask.shape[1]) == (layout.feature_dim, layout.num_offsets)


def test_a_full_disk_is_an_error_of_the_system_that_names_the_file(tmp_path, monkeypatch):
    def full(*arguments: object, **options: object) -> None:
        raise SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)")

    monkeypatch.setattr(tensor_file, "save_file", full)
    with pytest.raises(OSError, match="No space left on device") as failed:
        tensor_file.write_tensors({"a": np.zeros(3)}, {}, tmp_path / "a.scene")
    assert (failed.value.errno, failed.value.filename) == (errno.ENOSPC, str(tmp_path / "a.scene"))
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_truncated_while_it_is_read_is_an_error(tmp_path):
    path = tmp_path / "a"
    tensor_file.write_tensors({"a": np.zeros(1 << 20), "b": np.zeros(1 << 20)}, {}, path)
    with open_tensor_file(path) as file:
        assert not file.tensor("a").any()
        os.truncate(path, 4096)
        with pytest.raises(BitstreamError, match="it ends early"):
            file.tensor("b")


@pytest.mark.parametrize("size", [0, 9])
def test_a_file_that_is_replaced_while_it_is_read_stays_the_same(size, tmp_path):
    path = tmp_path / "a"
    tensor_file.write_tensors({"a": np.zeros(5), "b": np.ones(5)}, {}, path)
    with open_tensor_file(path) as file:
        tensor_file.write_tensors({"a": np.full(size, 7.0), "b": np.full(size, 8.0)}, {}, path)
        assert file.tensor("b").tolist() == [1.0] * 5


@pytest.mark.parametrize("kind", ["f8", "f4", "f2", "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", "?"])
@pytest.mark.parametrize("shape", [(), (0,), (3, 0, 2), (2, 3)])
def test_tensors_are_those_of_the_library(kind, shape, tmp_path):
    value = np.arange(int(np.prod(shape)), dtype=np.int8).reshape(shape).astype(kind)
    save_file({"a": value, "b": np.ones(3, np.uint8)}, tmp_path / "a", metadata={"text": "x"})
    with open_tensor_file(tmp_path / "a") as file:
        assert (set(file.names), file.metadata) == ({"a", "b"}, {"text": "x"})
        assert (file.shape("a"), file.num_bytes("a")) == (shape, value.nbytes)
        read = file.tensor("a")
    assert read.dtype == value.dtype
    assert np.array_equal(read, value)


def _entry(start=0, stop=4, shape=(1,), dtype="F32"):
    return {"dtype": dtype, "shape": list(shape), "data_offsets": [start, stop]}


@pytest.mark.parametrize(
    ("header", "size", "reason"),
    [
        ({"a": _entry()}, 5, "its tensors need"),
        ({"a": _entry()}, 3, "bytes, its tensors need"),
        ({"a": _entry(4, 8)}, 8, "overlap or leave a gap"),
        ({"a": _entry(), "b": _entry(0, 4)}, 4, "overlap or leave a gap"),
        ({"a": _entry(shape=(1 << 40, 1 << 40))}, 4, "has 4 bytes, its shape needs"),
        ({"a": _entry(shape=(-1,))}, 4, "no valid shape"),
        ({"a": _entry(shape=(1.0,))}, 4, "no valid shape"),
        ({"a": _entry(shape=(True,))}, 4, "no valid shape"),
        ({"a": {"dtype": "F32", "shape": 1, "data_offsets": 4}}, 4, "no valid shape"),
        ({"a": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4, 4]}}, 4, "no valid shape"),
        ({"a": 3}, 4, "no valid shape"),
        ({"a": _entry(dtype="F8_E4M3")}, 4, "type 'F8_E4M3', which is not read"),
        ({"a": _entry(dtype=["F32"])}, 4, "which is not read"),
        ({"__metadata__": {"splatwire": 3}}, 0, "does not hold texts"),
        ({"__metadata__": [3]}, 0, "does not hold texts"),
        ([3], 0, "no JSON object"),
        ({"a": _entry(shape=(1,) * 33)}, 4, "33 dimensions"),
        ({"a": _entry(0, 0, (0, 1 << 40, 1 << 40))}, 0, "a shape that is too large"),
        ({"a": _entry(0, 0, (1 << 62, 4, 0))}, 0, "a shape that is too large"),
    ],
)
def test_a_damaged_header_is_refused_with_the_reason(header, size, reason, tmp_path):
    text = json.dumps(header).encode()
    (tmp_path / "a").write_bytes(struct.pack("<Q", len(text)) + text + bytes(size))
    with pytest.raises(BitstreamError, match=reason), open_tensor_file(tmp_path / "a"):
        pass


_TEXT = json.dumps({"a": _entry()})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (f'{{"a": {json.dumps(_entry())}, {_TEXT[1:]}'.encode(), "has 'a' twice"),
        (_TEXT.replace('"dtype"', '"dtype": "I8", "dtype"').encode(), "has 'dtype' twice"),
        (_TEXT.replace("{", '{"__metadata__": {}, "__metadata__": {}, ', 1).encode(), "has '__metadata__' twice"),
        (_TEXT.replace("}}", ', "b": NaN}}').encode(), "no JSON"),
        (_TEXT.encode("utf-16-le"), "no JSON"),
        (_TEXT.encode("utf-8-sig"), "no JSON"),
        (b'{"\xff": 0}', "no JSON"),
    ],
)
def test_a_header_that_readers_could_read_differently_is_refused(text, reason, tmp_path):
    (tmp_path / "a").write_bytes(struct.pack("<Q", len(text)) + text + bytes(4))
    with pytest.raises(BitstreamError, match=reason), open_tensor_file(tmp_path / "a"):
        pass


def test_a_header_that_would_fill_the_memory_is_refused(tmp_path):
    with (tmp_path / "a").open("wb") as file:
        file.write(struct.pack("<Q", (8 << 20) + 1))
        file.truncate(9 << 20)
    with pytest.raises(BitstreamError, match="its header has 8,388,609 bytes"), open_tensor_file(tmp_path / "a"):
        pass


@pytest.mark.parametrize("data", [b"", b"\1\0", struct.pack("<Q", 1 << 60) + b"{}", struct.pack("<Q", 3) + b"{}"])
def test_a_file_without_a_whole_header_is_refused(data, tmp_path):
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(BitstreamError, match=r"safetensors file|ends early"), open_tensor_file(tmp_path / "a"):
        pass


def test_deprecated_names_of_context_features_and_context_model_warn_and_give_the_new_values(tiny_scene, tiny_partial):
    with pytest.warns(DeprecationWarning, match="use context_features"):
        assert tiny_partial[Prior].context is tiny_partial[Prior].context_features
    with pytest.warns(DeprecationWarning, match="use context_model"):
        assert tiny_scene.coding.context is tiny_scene.coding.context_model
