"""Views for fine-tuning: none is a view of an evaluation."""

import numpy as np
import pytest

from shells import shell
from splatwire.evaluation.views import held_out_cameras, held_out_closeups
from splatwire.finetuning import fitting_cameras


@pytest.mark.parametrize(
    "num_views", [2, *(pytest.param(number, marks=pytest.mark.slow) for number in (5, 17, 18, 90, 95))]
)
def test_no_view_is_held_out(num_views: int) -> None:
    scene = shell(300)
    fitted = fitting_cameras(scene, num_views, 48)
    assert (fitted.num_views, len(set(fitted.names))) == (num_views, num_views)
    for views in (held_out_cameras(scene), held_out_closeups(scene)):
        assert np.abs(fitted.viewmats[:, None] - views.viewmats[None]).max(axis=(2, 3)).min() > 1e-4
