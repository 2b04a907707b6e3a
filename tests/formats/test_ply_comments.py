"""Comments and columns of training programs: antialiasing, and the 3D filter of Mip-Splatting."""

import lzma
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from formats.handmade import some_splats
from splatwire.formats import is_antialiased, read_content, read_splats, write_splats
from splatwire.formats.ply_comments import states_antialiasing
from splatwire.scene.splats import Splats


def commented(folder: Path, *comments: str, newline: str = "\n") -> Path:
    """A PLY with more comments in its header."""
    path = folder / "commented.ply"
    write_splats([some_splats(30, 1)], path)
    head, mark, rows = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    lines[2:2] = [f"comment {text}" for text in comments]
    path.write_bytes(newline.join([*lines, mark.decode().strip(), ""]).encode() + rows)
    return path


@pytest.mark.parametrize(
    "comment",
    [
        "SplatRenderMode: mip", "splatrendermode=MIP", "SplatRenderMode mip", "Render_Mode: antialiased",
        "rasterize_mode: antialiased", "RasterizationMode: Mip-Splatting", "antialiased 1", "Antialiased: True",
        "anti-aliased yes", "anti_aliasing=on", "antialiasing enabled", "antialiased", "mip_splatting: true",
        'SplatRenderMode: "mip"',
    ],
)  # fmt: skip
def test_comments_of_training_programs_ask_for_antialiasing(comment: str, tmp_path: Path) -> None:
    path = commented(tmp_path, "Exported from a program", comment)
    assert is_antialiased(path)
    assert read_content(path).antialiased


@pytest.mark.parametrize(
    "comment",
    [
        "SplatRenderMode: default", "SplatRenderMode: classic", "antialiased 0", "antialiased: false",
        "anti-aliased no", "not antialiased", "antialiased pictures of a house", "mipmap 1", "mip 0",
        "trained without antialiasing", "filter: mip", "",
    ],
)  # fmt: skip
def test_other_comments_do_not(comment: str, tmp_path: Path) -> None:
    path = commented(tmp_path, comment)
    assert not is_antialiased(path)
    assert not read_content(path).antialiased


def test_the_last_comment_counts() -> None:
    assert states_antialiasing(["antialiased 0", "SplatRenderMode: mip"])
    assert not states_antialiasing(["SplatRenderMode: mip", "antialiased 0"])


@pytest.mark.parametrize("newline", ["\r\n", "\r"])
def test_comments_are_read_with_any_line_ends_and_from_archives(newline: str, tmp_path: Path) -> None:
    path = commented(tmp_path, "antialiased 1", newline=newline)
    packed = tmp_path / "packed.ply"
    packed.write_bytes(lzma.compress(path.read_bytes()))
    assert is_antialiased(path)
    assert is_antialiased(packed)
    assert read_content(packed).antialiased


def with_filter(splats: Splats, sizes: np.ndarray, path: Path, name: str = "filter_3D") -> Path:
    """A PLY with one more property, the standard deviation of each Gaussian's filter."""
    write_splats([splats], path)
    head, mark, data = path.read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(data, "<f4").reshape(splats.num_gaussians, -1)
    filtered = np.concatenate([rows, sizes[:, None].astype("<f4")], axis=1)
    path.write_bytes(head + f"property float {name}\n".encode() + mark + filtered.tobytes())
    return path


@pytest.mark.parametrize("name", ["filter_3D", "filter_3d"])
def test_the_filter_of_mip_splatting_widens_gaussians_and_keeps_their_mass(name: str, tmp_path: Path) -> None:
    splats = some_splats(200, 1)
    sizes = np.linspace(0, 0.2, 200)
    found = read_splats(with_filter(splats, sizes, tmp_path / "a.ply", name))
    squares = splats.scales.astype(np.float64) ** 2
    wider = squares + sizes.astype(np.float64)[:, None] ** 2
    opacities = splats.opacities.astype(np.float64) * np.sqrt(squares.prod(axis=1) / wider.prod(axis=1))
    assert np.allclose(found.scales.astype(np.float64), np.sqrt(wider), rtol=1e-5)
    assert np.allclose(found.opacities.astype(np.float64), opacities, rtol=1e-4, atol=2e-6)
    assert np.array_equal(found.means, splats.means)


def test_filters_of_tiny_gaussians_and_impossible_filters_are_judged(tmp_path: Path) -> None:
    splats = some_splats(4, 0)
    splats = replace(splats, scales=np.full_like(splats.scales, 1e-20))
    sizes = np.array([0.0, 1e-3, np.nan, np.inf], np.float32)
    found = read_splats(with_filter(splats, sizes, tmp_path / "a.ply"))
    assert found.num_gaussians == 1  # of the second nothing can be seen, the others are impossible
    assert float(found.scales[0, 0]) == pytest.approx(1e-20, rel=1e-4)
