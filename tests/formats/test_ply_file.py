import lzma
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatwire.errors import DatasetError
from splatwire.formats.ply_file import read_ply

HEAD = (
    b"ply\nformat binary_little_endian 1.0\ncomment by hand\nelement vertex 2\nproperty float x\nproperty float w_0\n"
)
BODY = struct.pack("<4f", 1.5, -2.0, 3.25, 1e-30)
GOOD = HEAD + b"end_header\n" + BODY


def test_a_file_built_by_hand_is_read(tmp_path):
    (tmp_path / "a.ply").write_bytes(GOOD)
    vertices = read_ply(tmp_path / "a.ply")
    assert vertices.names == ("x", "w_0")
    assert np.array_equal(vertices.select(["x", "w_0"]), np.float32([[1.5, -2.0], [3.25, 1e-30]]))
    assert vertices.columns("w_", 1).tolist() == [[-2.0], [np.float32(1e-30)]]


def test_xz_is_unpacked(tmp_path):
    (tmp_path / "a.ply.xz").write_bytes(lzma.compress(GOOD))
    assert read_ply(tmp_path / "a.ply.xz").rows["x"][1] == 3.25


BAD = {
    "truncated": (GOOD[:-1], "ends early"),
    "too long": (GOOD + b"\0", "goes on after the last row"),
    "no header end": (b"ply\n" * 30, "no end_header"),
    "endless header": (b"ply\n" * 100_000, "no end_header"),
    "empty": (b"", "no end_header"),
    "ascii": (GOOD.replace(b"binary_little_endian", b"ascii"), "not a binary little-endian PLY"),
    "big endian": (GOOD.replace(b"little", b"big"), "not a binary little-endian PLY"),
    "double": (GOOD.replace(b"float w_0", b"double w_0") + bytes(8), "float64 w_0"),
    "list": (GOOD.replace(b"float w_0", b"list uchar int w_0"), "float property"),
    "same name": (GOOD.replace(b"w_0", b"x"), "all different"),
    "negative": (GOOD.replace(b"vertex 2", b"vertex -2"), "the only element must be 'vertex'"),
    "huge": (GOOD.replace(b"vertex 2", b"vertex 99999999999"), "more than the limit"),
    "large": (GOOD.replace(b"vertex 2", b"vertex 9999999"), "cannot hold"),
    "faces": (GOOD.replace(b"end_h", b"element face 0\nproperty int a\nend_h"), "element face 0"),
    "no properties": (b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nend_header\n", "0 properties"),
    "nan": (GOOD[:-4] + struct.pack("<f", float("nan")), "vertex 1 has nan as w_0"),
    "infinite": (GOOD[:-8] + struct.pack("<ff", float("inf"), 0), "vertex 1 has inf as x"),
    "zeros in it": (GOOD.replace(b"by hand\n", b"by hand\nelement x\0y 1\n"), "no line of a PLY header"),
    "umlaut": (GOOD.replace(b"by hand", b"\xc3\xbc"), "not ASCII"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_said_with_the_file(name, tmp_path):
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


def test_a_packed_bomb_is_not_unpacked(tmp_path):
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
def test_damage_is_one_clear_error_or_finite_values(at, flip, cut, tmp_path):
    raw = bytearray(GOOD)
    raw[at] ^= flip
    (tmp_path / "a.ply").write_bytes(raw[:at] if cut else raw)
    try:
        vertices = read_ply(tmp_path / "a.ply")
    except DatasetError:
        return
    assert np.isfinite(vertices.select(list(vertices.names))).all()
    assert vertices.rows.nbytes == len(BODY)
