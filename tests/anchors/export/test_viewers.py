"""Data passed to viser and Rerun, and the viewers themselves where installed (`pip install --group viewers`)."""

from pathlib import Path

import numpy as np
import pytest

from scenes import tiny_scene
from splatwire.anchors.export.viewers import rerun_arguments, viser_arguments
from splatwire.errors import InvalidValueError
from splatwire.ops.spherical_harmonics import DC
from splatwire.types import SplatScene
from web.test_page import ball

pytestmark = pytest.mark.slow

INTERCHANGE = Path(__file__).resolve().parents[3] / "docs" / "interchange.md"


def documented(word: str) -> str:
    """Line of the document that begins with a word."""
    [line] = [line for line in INTERCHANGE.read_text(encoding="utf-8").splitlines() if line.startswith(word)]
    return line


def scene(degree: int = 2) -> SplatScene:
    return SplatScene(ball(degree=degree))


def test_covariances_follow_from_axes_and_scales() -> None:
    """Ellipsoid axes are eigenvectors and squared sizes eigenvalues; a second library gives the rotations."""
    from scipy.spatial.transform import Rotation

    splats, found = scene().splats, viser_arguments(scene())
    turns = Rotation.from_quat(np.roll(splats.quats, -1, axis=1)).as_matrix()
    for axis in range(3):
        column, size = turns[:, :, axis], splats.scales[:, axis]
        turned = np.einsum("gij,gj->gi", found["covariances"], column)
        assert np.allclose(turned, column * size[:, None] ** 2, atol=1e-6)
    assert np.allclose(found["rgbs"], (0.5 + DC * splats.sh[:, 0]).clip(0, 1))


def test_gaussians_that_depend_on_the_view_are_refused() -> None:
    with pytest.raises(InvalidValueError, match="export ply"):
        viser_arguments(tiny_scene(num_anchors=20))


def test_viser_accepts_the_gaussians() -> None:
    viser = pytest.importorskip("viser", reason="viser is not installed (--group viewers)")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        names = {"server": server, "scene": scene(), "viser_arguments": viser_arguments}
        handle = eval(documented("server.scene."), names)
        rows = handle.buffer.view(np.float32)[:, :3]
        assert np.array_equal(rows, scene().splats.means)
        assert np.all(handle.buffer.view(np.uint8)[:, 31] > 0), "opacities"
    finally:
        server.stop()


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_rerun_accepts_the_gaussians(degree: int, tmp_path: Path) -> None:
    rerun = pytest.importorskip("rerun", reason="Rerun is not installed (--group viewers)")
    splats = scene(degree).splats
    logged = rerun.GaussianSplats3D(**rerun_arguments(scene(degree)))
    flat = lambda batch: np.array(batch.as_arrow_array().flatten().to_numpy(zero_copy_only=False))  # noqa: E731
    assert np.array_equal(flat(logged.centers).reshape(-1, 3), splats.means)
    assert np.array_equal(flat(logged.scales).reshape(-1, 3), splats.scales)
    x, w = flat(logged.quaternions).reshape(-1, 4)[:, [0, 3]].T
    assert np.allclose(x, splats.quats[:, 1])
    assert np.allclose(w, splats.quats[:, 0])
    alpha = logged.colors.as_arrow_array().to_numpy() & 255
    assert np.abs(alpha / 255 - splats.opacities).max() <= 0.5 / 255 + 1e-6
    if degree == 0:
        assert logged.sh_coefficients is None
    else:
        values = logged.sh_coefficients.as_arrow_array()
        while hasattr(values, "flatten") and "list" in str(values.type):
            values = values.flatten()
        given = np.asarray(values.to_numpy(zero_copy_only=False), np.float32).reshape(len(splats.means), 15, 3)
        assert np.allclose(given[:, : splats.sh.shape[1] - 1], splats.sh[:, 1:], atol=1e-3)
        assert not given[:, splats.sh.shape[1] - 1 :].any()
    assert np.isfinite(splats.means).all()
    rerun.init("splatwire")
    rerun.save(tmp_path / "scene.rrd")
    eval(documented("rerun.log"), {"rerun": rerun, "scene": scene(degree), "rerun_arguments": rerun_arguments})
    rerun.disconnect()
    assert (tmp_path / "scene.rrd").stat().st_size > splats.means.nbytes
