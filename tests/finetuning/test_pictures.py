"""Views for fine-tuning: some are close to surfaces, and none is a view of an evaluation."""

import numpy as np
import pytest

from shells import shell
from splatwire.evaluation.views import held_out_cameras, held_out_closeups
from splatwire.finetuning import fitting_cameras
from splatwire.render.closeups import closeup_cameras
from splatwire.render.importance import surrounding_cameras


def test_a_sixth_of_the_views_is_close_to_surfaces() -> None:
    scene = shell(300)
    fitted, close = fitting_cameras(scene, 24, 48), closeup_cameras(scene, 4, 48)
    assert (fitted.viewmats[-4:] == close.viewmats).all()
    away = np.linalg.norm(fitted.centers, axis=1)
    assert away[-4:].mean() < 0.5 * away[:-4].mean()


def test_near_plane_is_the_nearest_of_all_views() -> None:
    scene = shell(300)
    near = closeup_cameras(scene, 4, 48).near_depth, surrounding_cameras(scene, 16, 48).near_depth
    assert fitting_cameras(scene, 24, 48).near_depth == min(near)


@pytest.mark.parametrize("num_views", [2, 5, 21, 22, 90, 95])
def test_no_view_is_held_out(num_views: int) -> None:
    scene = shell(300)
    fitted = fitting_cameras(scene, num_views, 48)
    assert (fitted.num_views, len(set(fitted.names))) == (num_views, num_views)
    for views in (held_out_cameras(scene), held_out_closeups(scene)):
        assert np.abs(fitted.viewmats[:, None] - views.viewmats[None]).max(axis=(2, 3)).min() > 1e-4
