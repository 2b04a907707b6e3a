"""glTF: node transforms, several primitives and meshes, documents with their buffers."""

import base64
import json
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from close import assert_close, unit
from random_numbers import Numbers
from splat_io.formats.handmade import glb, glb_of, some_splats, write
from splatwire.errors import DatasetError
from splatwire.files.kinds import GLTF, file_kind
from splatwire.io.formats import gltf, is_antialiased, read_splats, splats_kind, write_splats
from splatwire.io.formats._axes import GLTF_FLIPS, flip_axes
from splatwire.io.formats._columns import MIN_SIZE
from splatwire.io.formats.dispatch import read_content
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import DC, sh_basis
from splatwire.types.splats import Splats

HALF = math.sqrt(0.5)
EXTENSION = "KHR_gaussian_splatting"


def covariances(splats: Splats) -> np.ndarray:
    axes = rotation_matrices(splats.quats.astype(np.float64)) * splats.scales.astype(np.float64)[:, None, :]
    return axes @ axes.swapaxes(1, 2)


def colours(splats: Splats, directions: np.ndarray) -> np.ndarray:
    """Colour of each Gaussian in some directions, (directions, Gaussians, 3)."""
    return np.einsum("kd,gdc->kgc", sh_basis(directions, splats.degree), splats.sh.astype(np.float64))


def opened(data: bytes, path: Path) -> Splats:
    """Gaussians of a file in the axes of the file."""
    return flip_axes(read_splats(write(path, data)), GLTF_FLIPS)


def document_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def turn(axis: int, angle: float) -> np.ndarray:
    a, b = [n for n in range(3) if n != axis]
    matrix = np.eye(4)
    matrix[a, a] = matrix[b, b] = math.cos(angle)
    matrix[a, b], matrix[b, a] = -math.sin(angle), math.sin(angle)
    return matrix


def column_major(matrix: np.ndarray) -> list[float]:
    return matrix.T.ravel().tolist()


def of_parts(translation: Any = (0, 0, 0), linear: Any = None) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if linear is None else linear
    matrix[:3, 3] = translation
    return matrix


ABOUT_X = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
SKEW = np.array([[1.0, 0.4, 0], [0, 2.0, -0.3], [0.2, 0, 0.5]])
TRANSFORMS: dict[str, tuple[list[dict[str, Any]], np.ndarray]] = {
    "rotation": ([{"mesh": 0, "rotation": [HALF, 0, 0, HALF]}], of_parts(linear=ABOUT_X)),
    "translation": ([{"mesh": 0, "translation": [1, 2, 3]}], of_parts((1, 2, 3))),
    "scale": ([{"mesh": 0, "scale": [2, 2, 2]}], of_parts(linear=2 * np.eye(3))),
    "mirror": ([{"mesh": 0, "scale": [-1, 1, 1]}], of_parts(linear=np.diag([-1, 1, 1]))),
    "all three": (
        [{"mesh": 0, "scale": [3, 3, 3], "rotation": [HALF, 0, 0, HALF], "translation": [1, 2, 3]}],
        of_parts((1, 2, 3), 3 * ABOUT_X),
    ),
    "matrix": ([{"mesh": 0, "matrix": column_major(turn(2, 0.7))}], turn(2, 0.7)),
    "parent": (
        [{"mesh": 0, "rotation": [HALF, 0, 0, HALF]}, {"children": [0], "matrix": column_major(turn(1, 1.1))}],
        turn(1, 1.1) @ of_parts(linear=ABOUT_X),
    ),
    "grandparent": (
        [
            {"children": [1], "translation": [0, 1, 0]},
            {"children": [2], "scale": [2, 2, 2]},
            {"mesh": 0, "translation": [1, 0, 0]},
        ],
        of_parts((2, 1, 0), 2 * np.eye(3)),
    ),
    "stretch": ([{"mesh": 0, "scale": [1, 3, 0.5]}], of_parts(linear=np.diag([1, 3, 0.5]))),
    "skew": ([{"mesh": 0, "matrix": column_major(of_parts((1, 0, 0), SKEW))}], of_parts((1, 0, 0), SKEW)),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_node_transforms_apply_to_gaussians(name: str, tmp_path: Path) -> None:
    nodes, expected = TRANSFORMS[name]
    matrix, shift = (part.copy() for part in (expected[:3, :3], expected[:3, 3]))
    splats = some_splats(30)
    found = opened(glb(splats, {"nodes": nodes}), tmp_path / "a.glb")
    assert_close(
        found.means.astype(np.float64), splats.means.astype(np.float64) @ matrix.T + shift, atol=1e-5, rtol=1e-5
    )
    assert_close(covariances(found), matrix @ covariances(splats) @ matrix.T, atol=1e-7, rtol=1e-4)
    assert_close(found.opacities, splats.opacities)


@pytest.mark.parametrize("name", sorted(set(TRANSFORMS) - {"stretch", "skew"}))
def test_harmonics_rotate_with_their_node(name: str, tmp_path: Path) -> None:
    nodes, expected = TRANSFORMS[name]
    orthogonal = expected[:3, :3] / abs(np.linalg.det(expected[:3, :3])) ** (1 / 3)
    splats = some_splats(30)
    found = opened(glb(splats, {"nodes": nodes}), tmp_path / "a.glb")
    directions = Numbers(1).randn(9, 3).astype(np.float64)
    directions = unit(directions)
    assert_close(colours(found, directions), colours(splats, directions @ orthogonal), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("degree", "warned"), [(0, False), (1, True)])
def test_nonuniform_scaling_of_harmonics_is_warned_about(
    degree: int, warned: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    opened(glb(some_splats(5, degree), {"nodes": [{"mesh": 0, "scale": [1, 2, 1]}]}), tmp_path / "a.glb")
    assert ("stretches" in caplog.text) is warned


def test_flattening_node_gives_flat_gaussians(tmp_path: Path) -> None:
    found = opened(glb(some_splats(20, 0), {"nodes": [{"mesh": 0, "scale": [1, 1, 0]}]}), tmp_path / "a.glb")
    assert found.num_gaussians == 20
    assert not found.means[:, 2].any()
    assert float(found.scales.min(axis=1).max()) < 1e-8


def two_primitives(splats: Splats, other: Splats) -> bytes:
    """A mesh of two primitives, each with its own part of the buffer."""
    (one, first), (two, second) = (document_of(glb(part)) for part in (splats, other))
    for view in two["bufferViews"]:
        view["byteOffset"] += len(first)
    for accessor in two["accessors"]:
        accessor["bufferView"] += len(one["bufferViews"])
    [primitive] = two["meshes"][0]["primitives"]
    primitive["attributes"] = {name: n + len(one["accessors"]) for name, n in primitive["attributes"].items()}
    one["meshes"][0]["primitives"].append(primitive)
    for name in ("bufferViews", "accessors"):
        one[name] += two[name]
    one["buffers"] = [{"byteLength": len(first) + len(second)}]
    return glb_of(one, first + second)


def test_all_primitives_are_read(tmp_path: Path) -> None:
    parts = some_splats(30, 1, 1), some_splats(20, 1, 2)
    found = opened(two_primitives(*parts), tmp_path / "a.glb")
    for name, values in vars(found).items():
        assert_close(values, np.concatenate([getattr(part, name) for part in parts]))


def test_primitives_may_have_different_degrees(tmp_path: Path) -> None:
    parts = some_splats(30, 0, 1), some_splats(20, 2, 2)
    found = opened(two_primitives(*parts), tmp_path / "a.glb")
    assert found.degree == 2
    assert_close(found.sh[:30, :1], parts[0].sh)
    assert not found.sh[:30, 1:].any()
    assert_close(found.sh[30:], parts[1].sh)


def test_a_mesh_may_be_shown_by_several_nodes(tmp_path: Path) -> None:
    splats = some_splats(30, 1)
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0]}]
    found = opened(glb(splats, {"nodes": nodes}), tmp_path / "a.glb")
    shift = np.array([10.0, 0, 0], np.float32)
    assert_close(found.means, np.concatenate([splats.means, splats.means + shift]), atol=1e-5, rtol=1e-5)


def test_nodes_outside_the_scene_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document, binary = document_of(glb(some_splats(30, 1)))
    document |= {"nodes": [{"mesh": 0}, {"mesh": 1}], "scene": 1, "scenes": [{"nodes": [1]}, {"nodes": [0]}]}
    document["meshes"] *= 2
    found = opened(glb_of(document, binary), tmp_path / "a.glb")
    assert found.num_gaussians == 30
    assert "1 meshes of Gaussians that its scene does not show" in caplog.text


def test_other_primitives_are_ignored(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(30, 1)))
    document["meshes"].insert(0, {"primitives": [{"attributes": {"POSITION": 0}, "mode": 4}]})
    document["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    assert opened(glb_of(document, binary), tmp_path / "a.glb").num_gaussians == 30


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "no node of its scene|two parents, or is below itself"),
        ({"scenes": [{"nodes": [0, 0]}]}, "two parents"),
        ({"scenes": [{"nodes": [3]}]}, "there is no node 3"),
        ({"scenes": [{"nodes": [-1]}]}, "there is no node -1"),
        ({"scenes": [{"nodes": [0]}], "scene": 7}, "there is no scene 7"),
        ({"nodes": [{"mesh": 0, "matrix": [1] * 15}]}, "matrix of node 0 is not 16 numbers"),
        ({"nodes": [{"mesh": 0, "matrix": [1] * 16}]}, "no affine map"),
        ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}, "rotation of node 0 has length 0"),
        ({"nodes": [{"mesh": 0, "scale": [1, 1, float("nan")]}]}, "scale of node 0 is not 3 numbers"),
        ({"nodes": [{"mesh": 0, "translation": "far"}]}, "translation of node 0 is not 3 numbers"),
        ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "EXT_mesh_gpu_instancing"),
        ({"nodes": [{"mesh": 0}] * 20_000}, "meshes, at most 16,384"),
        ({"nodes": [{"mesh": 0}] * 16_000}, "more than .* bytes of file can hold"),
    ],
)
def test_impossible_nodes_are_refused(change: dict[str, Any], reason: str, tmp_path: Path) -> None:
    nodes = {"nodes": [{"mesh": 0}]}
    if "children" in str(change):
        change = change | {"scenes": [{"nodes": [0]}]}
    with pytest.raises(DatasetError, match=reason):
        read_splats(write(tmp_path / "a.glb", glb(some_splats(300, 0), nodes | change)))


def test_nodes_with_a_matrix_and_parts_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats, node = some_splats(30, 0), {"mesh": 0, "matrix": column_major(of_parts((1, 2, 3)))}
    expected = opened(glb(splats, {"nodes": [node]}), tmp_path / "a.glb")
    assert not caplog.messages
    both = node | {"translation": [5, 0, 0], "scale": [2, 2, 2]}
    found = opened(glb(splats, {"nodes": [both]}), tmp_path / "b.glb")
    assert np.array_equal(found.means, expected.means)
    assert "node 0 has a matrix and also translation, scale, which glTF does not allow" in caplog.text


def test_nodes_with_zero_scale_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    nodes = [{"mesh": 0}, {"mesh": 0, "scale": [0, 0, 0]}]
    assert opened(glb(some_splats(30, 0), {"nodes": nodes}), tmp_path / "a.glb").num_gaussians == 30
    assert "1 nodes that are scaled to nothing" in caplog.text


def test_compressed_buffer_views_are_named(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(30, 0)))
    document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {}}
    with pytest.raises(DatasetError, match="compressed by EXT_meshopt_compression"):
        read_splats(write(tmp_path / "a.glb", glb_of(document, binary)))


def _beside(document: dict[str, Any], binary: bytes, folder: Path) -> None:
    (folder / "my scene.bin").write_bytes(binary)
    document["buffers"][0]["uri"] = "my%20scene.bin"


def _below(document: dict[str, Any], binary: bytes, folder: Path) -> None:
    (folder / "data").mkdir()
    (folder / "data" / "a.bin").write_bytes(binary)
    document["buffers"][0]["uri"] = "data/a.bin"


def _inline(document: dict[str, Any], binary: bytes, _: Path) -> None:
    text = base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{text}"


def _two(document: dict[str, Any], binary: bytes, folder: Path) -> None:
    _beside(document, binary, folder)
    document["buffers"].insert(0, {"byteLength": 4, "uri": "absent.bin"})  # for example of a picture
    for view in document["bufferViews"]:
        view["buffer"] = 1


@pytest.mark.parametrize("place", [_beside, _below, _inline, _two])
@pytest.mark.parametrize("name", ["a.gltf", "a.json"])
def test_documents_are_read_with_their_buffers(
    place: Callable[[dict[str, Any], bytes, Path], None], name: str, tmp_path: Path
) -> None:
    splats = some_splats(30, 2)
    document, binary = document_of(glb(splats))
    place(document, binary, tmp_path)
    path = write(tmp_path / name, json.dumps(document).encode())
    assert file_kind(path) == GLTF
    assert splats_kind(path) == "glb"
    found = flip_axes(read_splats(path), GLTF_FLIPS)
    for key, values in vars(found).items():
        assert_close(values, getattr(splats, key))


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("../a.bin", "no file in the folder"),
        ("%2e%2e/a.bin", "no file in the folder"),
        ("/etc/passwd", "no file in the folder"),
        ("file:///etc/passwd", "no file in the folder"),
        ("https://example.org/a.bin", "no file in the folder"),
        ("//example.org/a.bin", "no file in the folder"),
        ("..\\a.bin", "no file in the folder"),
        ("absent.bin", "no such file"),
        ("data:application/octet-stream;base64,%%", "data: URI is damaged"),
        ("data:text/plain,abc", "not base64"),
        ("", "names no file"),
        (".", "names no file"),
        ("?a", "names no file"),
        ("#a", "names no file"),
        (None, "buffer 0 has no URI"),
        (3, "is no URI"),
    ],
)
def test_external_buffers_are_refused(uri: Any, reason: str, tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(30, 0)))
    (tmp_path / "in").mkdir()
    write(tmp_path / "a.bin", binary)
    document["buffers"][0] |= {} if uri is None else {"uri": uri}
    with pytest.raises(DatasetError, match=reason):
        read_splats(write(tmp_path / "in" / "a.gltf", json.dumps(document).encode()))


def test_buffers_behind_links_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats()))
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "secret").write_bytes(binary)
    (folder / "own.bin").write_bytes(binary)
    (folder / "link.bin").symlink_to("own.bin")
    (tmp_path / "other name").symlink_to(folder)
    for name, is_read in (("link.bin", True), ("out.bin", False), ("deep/out.bin", False)):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if not is_read:
            path.symlink_to(tmp_path / "secret")
        document["buffers"][0]["uri"] = name
        for place in (folder, tmp_path / "other name"):
            (place / "a.gltf").write_text(json.dumps(document))
            if is_read:
                assert read_splats(place / "a.gltf").num_gaussians == 20
            else:
                with pytest.raises(DatasetError, match="a link out of the folder"):
                    read_splats(place / "a.gltf")


def test_a_document_whose_files_are_links_into_one_folder_is_read(tmp_path: Path) -> None:
    """The cache of the Hugging Face Hub consists of such links."""
    document, binary = document_of(glb(some_splats()))
    document["buffers"][0]["uri"] = "deep/a.bin"
    blobs, scene = tmp_path / "blobs", tmp_path / "snapshots" / "revision"
    (scene / "deep").mkdir(parents=True)
    blobs.mkdir()
    (blobs / "1").write_text(json.dumps(document))
    (blobs / "2").write_bytes(binary)
    (tmp_path / "3").write_bytes(binary)
    (scene / "a.gltf").symlink_to("../../blobs/1")
    buffer = scene / "deep" / "a.bin"
    buffer.symlink_to("../../../blobs/2")
    assert read_splats(scene / "a.gltf").num_gaussians == 20
    for target in (tmp_path / "3", "../a.bin", "a.bin"):  # elsewhere; missing; itself
        buffer.unlink()
        buffer.symlink_to(target)
        with pytest.raises((DatasetError, OSError), match=r"a link out of the folder|a\.bin"):
            read_splats(scene / "a.gltf")


def test_gltf_without_gaussians_is_refused_with_a_reason(tmp_path: Path) -> None:
    document = {"asset": {"version": "2.0"}, "meshes": [{"primitives": [{"attributes": {}}]}]}
    with pytest.raises(DatasetError, match=f"no primitive with {EXTENSION}"):
        read_splats(write(tmp_path / "a.gltf", json.dumps(document).encode()))


def test_other_kernels_and_colour_spaces_are_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document, binary = document_of(glb(some_splats(30, 0)))
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION] = {"colorSpace": "lin_rec709_display"}
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert "colorSpace 'lin_rec709_display' is read as srgb_rec709_display" in caplog.text


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            {"extensionsRequired": ["KHR_gaussian_splatting", "KHR_gaussian_splatting_9"]},
            "requires KHR_gaussian_splatting_9",
        ),
        ({"extensionsRequired": ["EXT_moving_points"]}, "requires EXT_moving_points, which is not read"),
        ({"asset": {"version": "3.0"}}, "version is '3.0'; glTF of version 2 is read"),
        ({"asset": {"version": "2.0", "minVersion": "3.1"}}, "minVersion is '3.1'"),
        ({"asset": {"version": 2}}, "version is 2"),
        ({"nodes": [{"mesh": 9, "translation": [5, 0, 0]}]}, "there is no mesh 9"),
        ({"nodes": [{"mesh": "0", "translation": [5, 0, 0]}]}, "there is no mesh '0'"),
        ({"nodes": [{"mesh": 0}, {"mesh": -1}]}, "there is no mesh -1"),
    ],
)
def test_documents_that_require_unsupported_extensions_are_refused(
    change: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match=reason):
        read_splats(write(tmp_path / "a.glb", glb(some_splats(30, 0), change)))


def test_extensions_of_materials_may_be_required(tmp_path: Path) -> None:
    required = {"extensionsRequired": ["KHR_gaussian_splatting", "KHR_materials_unlit"], "asset": {"version": "2.1"}}
    assert opened(glb(some_splats(30, 0), required), tmp_path / "a.glb").num_gaussians == 30


@pytest.mark.parametrize("change", [{"mode": 4}, {"indices": 0}, {"targets": [{"POSITION": 0}]}])
def test_unsupported_parts_of_a_primitive_give_a_warning(
    change: dict[str, Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(30, 0)))
    document["meshes"][0]["primitives"][0] |= change
    assert opened(glb_of(document, binary), tmp_path / "a.glb").num_gaussians == 30
    assert f"{next(iter(change))} of a primitive of Gaussians are left out" in caplog.text


def test_unsupported_projections_orders_and_skins_give_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(30, 0), {"nodes": [{"mesh": 0, "skin": 0}]}))
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION] |= {"projection": "flat", "sortingMethod": "none"}
    opened(glb_of(document, binary), tmp_path / "a.glb")
    for text in ("projection 'flat' is read as perspective", "sortingMethod 'none' is read as", "skins of nodes"):
        assert text in caplog.text


def test_hidden_nodes_and_their_children_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    hidden = {"children": [1], "extensions": {"KHR_node_visibility": {"visible": False}}}
    nodes = {"nodes": [hidden, {"mesh": 0}, {"mesh": 0}]}
    assert opened(glb(some_splats(30, 0), nodes), tmp_path / "a.glb").num_gaussians == 30
    assert "node 0 and those below it are hidden by KHR_node_visibility" in caplog.text


def test_opacities_that_may_be_logits_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(20, 0)
    opened(glb(splats), tmp_path / "a.glb")
    assert not caplog.messages
    logits = np.log(splats.opacities / (1 - splats.opacities)).astype("<f4")
    document, binary = document_of(glb(splats))
    changed = binary.replace(splats.opacities.astype("<f4").tobytes(), logits.tobytes())
    opened(glb_of(document, changed), tmp_path / "b.glb")
    outside = int(((logits < -1e-3) | (logits > 1 + 1e-3)).sum())
    assert f"b.glb: {outside} of 20 opacities are outside of 0 to 1, so they may be logits" in caplog.text


def test_unapplied_placement_extras_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    asset = {"version": "2.0", "extras": {"title": "scale 3", "unit": "cm"}}
    opened(glb(some_splats(20, 0), {"asset": asset}), tmp_path / "a.glb")
    assert "field 'unit: cm' may be the unit of the positions: it is left out" in caplog.text
    assert len(caplog.messages) == 1


def test_sparse_accessors_replace_rows(tmp_path: Path) -> None:
    splats = some_splats(20, 0)
    document, binary = document_of(glb(splats))
    places, values = np.array([3, 17], "<u2").tobytes(), np.array([[1, 2, 3], [4, 5, 6]], "<f4").tobytes()
    start = len(binary)
    document["bufferViews"] += [
        {"buffer": 0, "byteOffset": start, "byteLength": 4},
        {"buffer": 0, "byteOffset": start + 4, "byteLength": 24},
    ]
    views = len(document["bufferViews"])
    document["accessors"][0]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": views - 2, "componentType": 5123},
        "values": {"bufferView": views - 1},
    }
    document["buffers"][0]["byteLength"] += 28
    expected = splats.means.copy()
    expected[[3, 17]] = [[1, 2, 3], [4, 5, 6]]
    assert np.array_equal(opened(glb_of(document, binary + places + values), tmp_path / "a.glb").means, expected)
    del document["accessors"][0]["bufferView"]
    expected = np.where(np.isin(np.arange(20), [3, 17])[:, None], expected, 0)
    assert np.array_equal(opened(glb_of(document, binary + places + values), tmp_path / "a.glb").means, expected)
    outside = np.array([3, 20], "<u2").tobytes()
    with pytest.raises(DatasetError, match="replaces a row that it does not have"):
        opened(glb_of(document, binary + outside + values), tmp_path / "a.glb")


def test_accessors_without_buffer_are_zero(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(20, 1)))
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    for i in range(3):
        del document["accessors"][attributes[f"{EXTENSION}:SH_DEGREE_1_COEF_{i}"]]["bufferView"]
    found = opened(glb_of(document, binary), tmp_path / "a.glb")
    assert found.degree == 1
    assert not found.sh[:, 1:].any()
    assert found.sh[:, 0].any()


def test_integer_positions_of_mesh_quantization_are_read(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    steps = np.random.default_rng(1).integers(-30_000, 30_000, (20, 4)).astype("<i2")
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": 160, "byteStride": 8})
    document["accessors"][0] |= {"bufferView": len(document["bufferViews"]) - 1, "componentType": 5122}
    document["buffers"][0]["byteLength"] += 160
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    document["nodes"][0]["scale"] = [2**-12] * 3
    found = opened(glb_of(document, binary + steps.tobytes()), tmp_path / "a.glb")
    assert_close(found.means, steps[:, :3] / 2.0**12, atol=1e-6)


@pytest.mark.parametrize("component", [5121, 5123])
def test_integer_scales_that_are_not_normalised_are_read(component: int, tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(3, 0)))
    values = np.array([[1, 2, 3], [4, 5, 0], [7, 8, 255]], {5121: "u1", 5123: "<u2"}[component])
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
    document["buffers"][0]["byteLength"] = len(binary) + values.nbytes
    scales = document["meshes"][0]["primitives"][0]["attributes"][f"{EXTENSION}:SCALE"]
    document["accessors"][scales] = {
        "bufferView": len(document["bufferViews"]) - 1, "componentType": component, "count": 3, "type": "VEC3",
    }  # fmt: skip
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary + values.tobytes()))
    found = read_content(tmp_path / "a.glb").splats
    assert_close(found.scales, np.maximum(values, MIN_SIZE).astype(np.float32))


def test_scales_of_a_draft_are_read_as_logarithms(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    splats = some_splats(60, 1)
    expected = opened(glb(splats), tmp_path / "a.glb")
    assert not caplog.text
    found = opened(glb(replace(splats, scales=np.log(splats.scales))), tmp_path / "b.glb")
    assert_close(found.scales, expected.scales, rtol=1e-5)
    assert "are read as logarithms, as in a draft of KHR_gaussian_splatting" in caplog.text


def test_vertex_colours_are_linear(tmp_path: Path) -> None:
    splats = some_splats(3, 0)
    splats.sh[:, 0] = (np.float32([[0, 0.5, 1], [0.02, -1, 2], [0.2, 0.8, 0.9]]) - 0.5) / np.float32(DC)
    write_splats([replace(splats, opacities=np.float32([0.5, 1, 0.25]))], tmp_path / "a.glb")
    document, binary = document_of((tmp_path / "a.glb").read_bytes())
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    colours = np.frombuffer(binary, np.uint8, 12, start).reshape(3, 4)
    # sRGB 0.5 is 0.214 of the light
    assert colours.tolist() == [[0, 55, 255, 128], [0, 0, 255, 255], [8, 154, 201, 64]]


@pytest.mark.parametrize("block", [1, 200, 1 << 20])
def test_rows_of_attributes_may_alternate(block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A buffer view with a stride, for positions, opacities and rotations one after the other."""
    monkeypatch.setattr(gltf, "_READ_BYTES", 36 * block)
    splats = some_splats(20, 0)
    document, binary = document_of(glb(splats))
    expected = opened(glb_of(document, binary), tmp_path / "a.glb")
    attributes, columns = document["meshes"][0]["primitives"][0]["attributes"], list[np.ndarray]()
    for name in ("POSITION", f"{EXTENSION}:OPACITY", f"{EXTENSION}:ROTATION"):
        accessor = document["accessors"][attributes[name]]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        width = 4 * {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        values = np.frombuffer(binary, "u1", 20 * width, start).reshape(20, width)
        accessor |= {"bufferView": len(document["bufferViews"]), "byteOffset": sum(c.shape[1] for c in columns)}
        columns.append(values)
    rows = np.concatenate(columns, axis=1)
    rows = np.concatenate([rows, np.zeros((20, 36 - rows.shape[1]), "u1")], axis=1)
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": 720, "byteStride": 36})
    document["buffers"][0]["byteLength"] += 720
    found = opened(glb_of(document, binary + rows.tobytes()), tmp_path / "b.glb")
    for name, values in vars(expected).items():
        assert np.array_equal(getattr(found, name), values), name


def test_rows_far_apart_are_refused(tmp_path: Path) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    document["bufferViews"].append({"buffer": 0, "byteOffset": 0, "byteLength": 1 << 13, "byteStride": 256})
    document["accessors"][0]["bufferView"] = len(document["bufferViews"]) - 1
    document["buffers"][0]["byteLength"] = 1 << 13
    with pytest.raises(DatasetError, match="256 bytes apart, above 252"):
        opened(glb_of(document, binary.ljust(1 << 13, b"\0")), tmp_path / "a.glb")


def test_unknown_settings_of_the_extension_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    settings = document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]
    settings["extras"] = {}
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert not caplog.text
    settings["antialiased"] = True
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert "antialiased of KHR_gaussian_splatting are not known" in caplog.text


@pytest.mark.parametrize("place", ["primitive", "extension", "mesh", "asset", "document"])
@pytest.mark.parametrize(("name", "value"), [("antialiased", 1), ("antialias", True), ("SplatRenderMode", "mip")])
def test_antialiasing_in_extras_is_read_under_each_name(
    place: str, name: str, value: object, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    primitive = document["meshes"][0]["primitives"][0]
    parts = {
        "primitive": primitive,
        "extension": primitive["extensions"][EXTENSION],
        "mesh": document["meshes"][0],
        "asset": document["asset"],
        "document": document,
    }
    parts[place].setdefault("extras", {})[name] = value
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert is_antialiased(tmp_path / "a.glb")
    assert not caplog.text
    parts[place]["extras"] = {name: "sometimes"}
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert not is_antialiased(tmp_path / "a.glb")
    assert f"field '{name}: sometimes' is not understood" in caplog.text


def test_unclear_antialiasing_of_many_primitives_gives_few_warnings(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    first = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"] = [{**first, "extras": {"antialiased": f"maybe {n}"}} for n in range(50)]
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert not is_antialiased(tmp_path / "a.glb")
    assert 0 < caplog.text.count("is not understood") < 10


def test_unclear_antialiasing_of_the_last_of_many_primitives_gives_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    first = document["meshes"][0]["primitives"][0]
    extras = [*({"a": str(n)} for n in range(10)), {"antialiased": "maybe"}]
    document["meshes"][0]["primitives"] = [{**first, "extras": fields} for fields in extras]
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert not is_antialiased(tmp_path / "a.glb")
    assert caplog.text.count("is not understood") == 1


def test_a_warning_about_one_primitive_says_how_the_scene_is_drawn(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    first = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"] = [{**first, "extras": {"antialiased": value}} for value in ("maybe", True)]
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert is_antialiased(tmp_path / "a.glb")
    assert "'antialiased: maybe' is not understood: the scene is drawn with antialiasing" in caplog.text
    assert "without" not in caplog.text


def test_many_nodes_give_one_warning_of_each_kind(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document, binary = document_of(glb(some_splats(20, 1)))
    wide = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    hidden = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}}
    document["nodes"] = [hidden, hidden, *({"mesh": 0, "matrix": wide, "scale": [1, 1, 1]} for _ in range(30))]
    document["scenes"] = [{"nodes": list(range(32))}]
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert len(caplog.messages) == 3
    assert "node 0 (and 1 more) and those below it are hidden" in caplog.text
    assert caplog.text.count("node 2 (and 29 more)") == 2


def test_primitives_that_disagree_about_antialiasing_give_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 0)))
    primitives = document["meshes"][0]["primitives"]
    primitives.append({**primitives[0], "extras": {"antialiased": True}})
    (tmp_path / "a.glb").write_bytes(glb_of(document, binary))
    assert is_antialiased(tmp_path / "a.glb")
    assert "some primitives ask for antialiasing, others do not" in caplog.text


def test_unknown_attributes_and_extensions_of_gaussians_give_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document, binary = document_of(glb(some_splats(20, 1)))
    primitive = document["meshes"][0]["primitives"][0]
    primitive["attributes"] |= {"COLOR_0": 0, "_TIME": 3}
    primitive["extensions"] |= {"KHR_materials_unlit": {}}
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert not caplog.text
    primitive["attributes"][f"{EXTENSION}:VELOCITY"] = 0
    primitive["extensions"]["EXT_other_positions"] = {}
    opened(glb_of(document, binary), tmp_path / "a.glb")
    assert f"EXT_other_positions, {EXTENSION}:VELOCITY of {EXTENSION} are not known" in caplog.text


def test_a_cut_file_is_named_as_cut(tmp_path: Path) -> None:
    data = glb(some_splats(20, 0))
    with pytest.raises(DatasetError, match=f"is cut: it has 1,000 of {len(data):,} bytes"):
        opened(data[:1000], tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"extensions": {"CESIUM_RTC": {"center": [100, 0, 0]}}}, "CESIUM_RTC"),
        ({"nodes": [{"mesh": 0, "extensions": {"MSFT_lod": {"ids": []}}}]}, "MSFT_lod"),
        ({"scenes": [{"nodes": [0], "extensions": {"ACME_offset": {}}}]}, "ACME_offset"),
        ({"extensions": {"KHR_lights_punctual": {"lights": []}}}, None),
        ({"extensions": {"EXT_structural_metadata": {"schema": {}}}}, None),
        ({"nodes": [{"mesh": 0, "extensions": {"KHR_node_selectability": {"selectable": True}}}]}, None),
        ({"nodes": [{"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": True}}}]}, None),
    ],
)
def test_unknown_extensions_around_gaussians_give_a_warning(change, named, tmp_path, caplog):
    read_splats(write(tmp_path / "a.glb", glb(some_splats(8, 1), change)))
    assert (f"extensions {named} of the document or its nodes are not known" in caplog.text) == bool(named)
    assert bool(caplog.messages) == bool(named)


def test_thousands_of_chunks_are_refused(tmp_path: Path) -> None:
    data = glb(some_splats())
    more = struct.pack("<I4s", 0, b"MORE")
    for count, is_refused in ((1_000, False), (1_100, True)):
        size = struct.pack("<I", len(data) + count * len(more))
        path = write(tmp_path / "a.glb", data[:8] + size + data[12:] + count * more)
        if is_refused:
            with pytest.raises(DatasetError, match=r"a\.glb: has more than 1,024 chunks"):
                read_splats(path)
        else:
            assert read_splats(path).num_gaussians == some_splats().num_gaussians
