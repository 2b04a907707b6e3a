import lzma
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splat_io.formats.handmade import FORMATS, ply, some_splats, write
from splatwire.errors import DatasetError
from splatwire.files.kinds import OTHER_PLY, file_kind
from splatwire.io.formats import read_splats, write_splats
from splatwire.io.formats.ply_file import PlyElement, read_ply, read_ply_elements

HEAD = (
    b"ply\nformat binary_little_endian 1.0\ncomment by hand\nelement vertex 2\nproperty float x\nproperty float w_0\n"
)
BODY = struct.pack("<4f", 1.5, -2.0, 3.25, 1e-30)
GOOD = HEAD + b"end_header\n" + BODY


def test_handmade_ply_is_read(tmp_path):
    (tmp_path / "a.ply").write_bytes(GOOD)
    vertices = read_ply(tmp_path / "a.ply")
    assert vertices.names == ("x", "w_0")
    assert np.array_equal(vertices.select(["x", "w_0"]), np.float32([[1.5, -2.0], [3.25, 1e-30]]))
    assert vertices.columns("w_", 1).tolist() == [[-2.0], [np.float32(1e-30)]]


@pytest.mark.parametrize(
    "content",
    [
        GOOD.replace(b"end_header", b"end_header \t"),
        GOOD.replace(b"ply\n", b"ply \n"),
        GOOD.replace(b"float x", b"float x  "),
        HEAD.replace(b"\n", b" \r\n") + b"end_header \r\n" + BODY,
    ],
)
def test_spaces_at_the_end_of_header_lines_are_accepted(content, tmp_path):
    (tmp_path / "a.ply").write_bytes(content)
    assert read_ply(tmp_path / "a.ply").rows["x"].tolist() == [1.5, 3.25]
    assert file_kind(tmp_path / "a.ply") == OTHER_PLY


def test_xz_is_unpacked(tmp_path):
    (tmp_path / "a.ply.xz").write_bytes(lzma.compress(GOOD))
    assert read_ply(tmp_path / "a.ply.xz").rows["x"][1] == 3.25


@pytest.mark.parametrize("types", ["<f4 <f4 <f4 <f4", ">f4 >f4 >f4 >f4", "<f4 <f8 <f4 <f4", "<f4 <f4 <u1 <f4"])
@pytest.mark.parametrize("names", [["a", "b", "c", "d"], ["b", "c"], ["c", "b"], ["a", "c"], ["d"], []])
@pytest.mark.parametrize("step", [1, 2])
def test_selected_columns_are_the_columns_of_these_names(types, names, step):
    rows = np.zeros(6, [(name, kind) for name, kind in zip("abcd", types.split(), strict=True)])
    for place, name in enumerate("abcd"):
        rows[name] = 10 * place + np.arange(6)
    some = PlyElement(Path("a.ply"), "vertex", rows[::step])
    expected = np.float32([[row[name] for name in names] for row in some.rows])
    assert np.array_equal(some.select(names), expected)
    assert np.array_equal(some.select_float64(names), expected.astype(np.float64))


BAD = {
    "truncated": (GOOD[:-1], "ends early"),
    "no header end": (b"ply\n" * 30, "no end_header"),
    "endless header": (b"ply\n" * 100_000, "the PLY header is longer than 65,536 bytes"),
    "empty": (b"", "no end_header"),
    "ascii": (GOOD.replace(b"binary_little_endian", b"ascii"), "stands where a number should be"),
    "another format": (GOOD.replace(b"little", b"middle"), r"not a PLY file of version 1.0 \(it starts with"),
    "another version": (GOOD.replace(b"1.0", b"1.1"), r"not a PLY file of version 1.0"),
    "double": (GOOD.replace(b"float w_0", b"double w_0") + bytes(8), "float64 w_0"),
    "list": (GOOD.replace(b"float w_0", b"list uchar int w_0"), r"vertex has list properties \(w_0\)"),
    "same name": (GOOD.replace(b"w_0", b"x"), "all different"),
    "negative": (GOOD.replace(b"vertex 2", b"vertex -2"), "no element with a number of rows"),
    "huge": (GOOD.replace(b"vertex 2", b"vertex 99999999999"), "more than the limit"),
    "large": (GOOD.replace(b"vertex 2", b"vertex 9999999"), "cannot hold"),
    "faces": (GOOD.replace(b"end_h", b"element face 0\nproperty int a\nend_h"), "element face 0"),
    "no properties": (b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nend_header\n", "0 properties"),
    "zeros in it": (GOOD.replace(b"by hand\n", b"by hand\nelement x\0y 1\n"), "no line of a PLY header"),
    "umlaut": (GOOD.replace(b"w_0", b"w\xc3\xbc"), "not ASCII"),
}


@pytest.mark.parametrize("name", BAD)
def test_errors_name_the_file_and_the_problem(name, tmp_path):
    content, reason = BAD[name]
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(DatasetError, match=reason) as caught:
        read_ply(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value)


def test_absent_and_damaged_packed_files_are_refused(tmp_path):
    packed = lzma.compress(GOOD)
    for name, content in {
        "cut": packed[:-9],
        "noise": b"\1" * 80,
        "flipped": packed[:40] + b"\xff" + packed[41:],
    }.items():
        (tmp_path / f"{name}.xz").write_bytes(content)
        with pytest.raises(DatasetError, match=name):
            read_ply(tmp_path / f"{name}.xz")
    with pytest.raises(DatasetError, match="absent"):
        read_ply(tmp_path / "absent.ply")


def test_decompression_bomb_is_refused(tmp_path):
    head = GOOD.replace(b"vertex 2", b"vertex 15000000")[: -len(BODY)]
    (tmp_path / "a.ply.xz").write_bytes(lzma.compress(head + bytes(1 << 20)))
    with pytest.raises(DatasetError, match="cannot hold"):
        read_ply(tmp_path / "a.ply.xz")


def test_missing_columns_are_named(tmp_path):
    (tmp_path / "a.ply").write_bytes(GOOD)
    vertices = read_ply(tmp_path / "a.ply")
    with pytest.raises(DatasetError, match="property y is missing"):
        vertices.select(["x", "y"])
    with pytest.raises(DatasetError, match=r"1 properties w_\*, expected 3"):
        vertices.columns("w_", 3)
    with pytest.raises(DatasetError, match="property f_0 is missing"):
        vertices.columns("f_")


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, len(GOOD) - 1), flip=st.integers(1, 255), cut=st.booleans())
def test_damage_is_one_error_or_the_announced_number_of_values(at, flip, cut, tmp_path):
    raw = bytearray(GOOD)
    raw[at] ^= flip
    (tmp_path / "a.ply").write_bytes(raw[:at] if cut else raw)
    try:
        vertices = read_ply(tmp_path / "a.ply")
    except DatasetError:
        return
    assert vertices.rows.nbytes == len(BODY)


MIXED = np.array(
    [(1.5, -2, 200, 1e-30, 4_000_000_000, -7), (0.1, 3, 0, -1e30, 1, 9)],
    dtype=[("x", "<f4"), ("n", "<i4"), ("red", "u1"), ("d", "<f8"), ("u", "<u4"), ("s", "<i2")],
)


@pytest.mark.parametrize("newline", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("form", FORMATS)
def test_every_number_encoding_gives_equal_values(form, newline, tmp_path):
    other = np.array([(5,), (6,), (7,)], dtype=[("label", "u1")])
    comments = ("comment von Jürgen: end_header".encode(), b"obj_info \xff\xfe", b"comment")
    (tmp_path / "a.ply").write_bytes(ply(form, {"other": other, "vertex": MIXED}, newline, comments))
    found = read_ply_elements(tmp_path / "a.ply")
    assert list(found) == ["other", "vertex"]
    for name, rows in (("other", other), ("vertex", MIXED)):
        assert found[name].names == rows.dtype.names
        for field in rows.dtype.names:
            assert found[name].rows[field].tolist() == rows[field].tolist()


@pytest.mark.parametrize("form", FORMATS)
def test_elements_with_lists_are_skipped_only_after_the_vertices(form, tmp_path):
    plain = ply(form, {"vertex": MIXED})
    faces = b"element face 1\nproperty list uchar int vertex_indices\nelement more 1\nproperty float a\nend_header\n"
    body = b"3 0 1 1\n2.5\n" if form == "ascii" else b"\3" + bytes(12 + 4)
    (tmp_path / "a.ply").write_bytes(plain.replace(b"end_header\n", faces) + body)
    found = read_ply_elements(tmp_path / "a.ply")
    assert list(found) == ["vertex"]
    assert found["vertex"].rows["d"].tolist() == MIXED["d"].tolist()
    before = b"element face 1\nproperty list uchar int vertex_indices\nelement vertex"
    (tmp_path / "a.ply").write_bytes(plain.replace(b"element vertex", before))
    with pytest.raises(
        DatasetError, match=r"a\.ply: no vertices: element face has lists, so neither it nor what follows"
    ):
        read_ply_elements(tmp_path / "a.ply")


TEXT = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty uchar y\nend_header\n"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"1 2 3", "ends early: 2 vertex rows of 2 numbers were promised"),
        (b"1 2 3 x", "'x' stands where a number should be"),
        (b"1 2 3 " + b"1" * 5000, "stands where a number should be"),
        (b"1 2 3 " + b"1" * (3 << 20), "stands where a number should be"),
        (b"1 2 3 256", r"256\.0 as y is no uint8"),
        (b"1 2 3 -1", r"-1\.0 as y is no uint8"),
        (b"1 2 3 0.5", r"0\.5 as y is no uint8"),
        (b"1 2 3 nan", r"nan as y is no uint8"),
    ],
)
def test_text_ply_errors_name_the_problem(body, reason, tmp_path):
    (tmp_path / "a.ply").write_bytes(TEXT + body)
    with pytest.raises(DatasetError, match=reason) as caught:
        read_ply_elements(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value)


def test_text_numbers_across_chunk_borders_are_read(tmp_path):
    """Contains more than one chunk of numbers, with line breaks anywhere."""
    count = 150_000
    values = np.random.default_rng(1).integers(0, 256, (count, 2))
    words = [str(value) for value in values.ravel().tolist()]
    breaks = [" ", "\n", "\t", "  \r\n"]
    body = "".join(word + breaks[place % 4] for place, word in enumerate(words))
    assert len(body) > 1 << 20
    (tmp_path / "a.ply").write_bytes(TEXT.replace(b"vertex 2", b"vertex %d" % count) + body.encode() + b" \n" * 9)
    rows = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    assert np.array_equal(rows["x"], values[:, 0])
    assert np.array_equal(rows["y"], values[:, 1])


def _gaussians(folder, kind):
    write_splats([some_splats(20, 0)], folder / "a.ply")
    return ply(kind, {"vertex": read_ply_elements(folder / "a.ply")["vertex"].rows})


@pytest.mark.parametrize("kind", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("more", [b"\n", b"\r\n" * 8, b"\n" * (2 << 20)])
def test_line_ends_after_the_last_row_are_accepted(kind, more, tmp_path, caplog):
    path = write(tmp_path / "b.ply", _gaussians(tmp_path, kind) + more)
    assert read_splats(path).num_gaussians == 20
    assert not caplog.messages


@pytest.mark.parametrize(
    ("kind", "more", "stated"),
    [
        ("binary_little_endian", b"\0", "1 bytes"),
        ("binary_little_endian", b"\n" + b"x" * 30, "31 bytes"),
        ("binary_little_endian", b"x" + b"\n" * ((2 << 20) + 1), "2,097,154 bytes"),
        ("ascii", b"1 2 3 and more", "5 words"),
        ("ascii", b"\nx" * ((1 << 20) + 1), "1,048,577 words"),
    ],
)
def test_bytes_after_the_last_row_give_a_warning(kind, more, stated, tmp_path, caplog):
    path = write(tmp_path / "b.ply", _gaussians(tmp_path, kind) + more)
    assert read_splats(path).num_gaussians == 20
    (message,) = caplog.messages
    assert f"b.ply: {stated} after the last row are not read" in message


@pytest.mark.parametrize("kind", ["binary_little_endian", "ascii"])
def test_a_file_without_elements_has_no_vertices(kind, tmp_path):
    path = write(tmp_path / "a.ply", f"ply\nformat {kind} 1.0\nend_header\nmore".encode())
    with pytest.raises(DatasetError, match="has no element vertex"):
        read_splats(path)


@pytest.mark.parametrize(("kind", "more"), [("binary_little_endian", bytes(80)), ("ascii", b" 1" * 20)])
def test_rows_that_may_be_longer_than_the_header_says_are_refused(kind, more, tmp_path):
    path = write(tmp_path / "b.ply", _gaussians(tmp_path, kind) + more)
    with pytest.raises(DatasetError, match=r"goes on after the last row: 20 vertex rows of .* were promised"):
        read_splats(path)


def test_elements_after_lists_give_a_warning(tmp_path, caplog):
    head, rows = _gaussians(tmp_path, "binary_little_endian").split(b"end_header\n", 1)
    faces = b"element face 1\nproperty list uchar int vertex_indices\n"
    camera = b"element camera 1\nproperty float view_px\n"
    lists = struct.pack("<B3i", 3, 0, 1, 2)
    path = write(tmp_path / "faces.ply", head + faces + b"end_header\n" + rows + lists)
    assert read_splats(path).num_gaussians == 20
    assert not caplog.messages
    path = write(tmp_path / "both.ply", head + faces + camera + b"end_header\n" + rows + lists + bytes(4))
    assert read_splats(path).num_gaussians == 20
    assert "both.ply: elements camera follow the lists of element face and are not read" in caplog.text


def test_chunks_beside_gaussians_of_single_properties_are_ignored(tmp_path):
    write_splats([some_splats(20, 0)], tmp_path / "a.ply")
    rows = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    chunks = np.zeros(1, [("min_x", "f4"), ("max_x", "f4")])
    path = write(tmp_path / "b.ply", ply("binary_little_endian", {"chunk": chunks, "vertex": rows}))
    assert np.array_equal(read_splats(path).means, read_splats(tmp_path / "a.ply").means)


@pytest.mark.parametrize(("kind", "dtype"), [("half", "f2"), ("float16", "f2"), ("int64", "i8"), ("uint64", "u8")])
def test_types_beyond_the_standard_are_read(kind, dtype, tmp_path):
    values = np.array([3, 1000], dtype)
    data = HEAD.replace(b"float w_0", f"{kind} w_0".encode()) + b"end_header\n"
    for x, value in zip((1.5, 3.25), values, strict=True):
        data += struct.pack("<f", x) + value.tobytes()
    (tmp_path / "a.ply").write_bytes(data)
    rows = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    assert (rows["x"].tolist(), rows["w_0"].tolist()) == ([1.5, 3.25], [3, 1000])


def test_gaussians_of_a_second_element_give_a_warning(tmp_path, caplog):
    write_splats([some_splats(20, 0)], tmp_path / "a.ply")
    vertices = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    for name, warned in (("camera", False), ("sky", True)):
        other = vertices[["x", "y", "opacity"]][:7] if warned else np.zeros(3, [("x", "f4")])
        other = np.array(other.tolist(), [(field, "f4") for field in other.dtype.names])
        path = write(tmp_path / "b.ply", ply("binary_little_endian", {"vertex": vertices, name: other}))
        assert read_splats(path).num_gaussians == 20
        assert ("only the element vertex is read: 7 Gaussians of sky are left out" in caplog.text) == warned


@pytest.mark.parametrize(
    ("name", "warned"),
    [("lod", True), ("beta", True), ("scale_t", True), ("rot_r_0", True), ("active", True), ("f_t_0", True),
     ("label", False), ("segment", False), ("confidence", False), ("red", False)],
)  # fmt: skip
def test_columns_that_may_change_gaussians_give_a_warning(name, warned, tmp_path, caplog):
    write_splats([some_splats(20, 0)], tmp_path / "a.ply")
    vertices = read_ply_elements(tmp_path / "a.ply")["vertex"].rows
    more = np.zeros(20, [*vertices.dtype.descr, (name, "f4")])
    for field in vertices.dtype.names:
        more[field] = vertices[field]
    read_splats(write(tmp_path / "b.ply", ply("binary_little_endian", {"vertex": more})))
    assert (f"properties {name} are not known and left out" in caplog.text) == warned


def test_colours_from_0_to_1_as_coefficients_give_a_warning(tmp_path, caplog):
    splats = some_splats(200, 0)
    write_splats([splats], tmp_path / "a.ply")
    read_splats(tmp_path / "a.ply")
    assert not caplog.messages
    splats.sh[:, 0] = np.linspace(0.02, 0.98, 600).reshape(200, 3)
    write_splats([splats], tmp_path / "a.ply")
    read_splats(tmp_path / "a.ply")
    assert "all properties f_dc_* are from 0.02 to 0.98, so they may be colours from 0 to 1" in caplog.text
