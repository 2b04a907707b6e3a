"""Selections of Gaussians, scenes and cameras."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from explicit import ball_of_gaussians
from scenes import tiny_cameras, tiny_scene
from splatwire.data.dataset import Dataset
from splatwire.errors import InvalidValueError
from splatwire.types import Attribute, LossMask, ReceivedScene, SplatCoding, SplatScene
from wrong_method_arguments import MESSAGES


def dataset_of(count: int) -> Dataset:
    return Dataset(tiny_cameras(count, 8, 8), (Path("a.png"),) * count)


def decoded_coding() -> SplatCoding:
    """Quantisation parameters of 200 Gaussians."""
    return SplatCoding(0, 0, 0, (0,), np.zeros((1, 1), np.int64), np.zeros(200, np.uint8))


@pytest.mark.parametrize("index", [[3, 0], (3, 0), np.array([3, 0], np.uint8), np.array([-197, 0]), slice(3, None, -3)])
def test_selections_of_every_kind_are_equal(index) -> None:
    splats, cameras = ball_of_gaussians(), tiny_cameras(200, 8, 8)
    assert splats.select(index).means.tolist() == splats.means[[3, 0]].tolist()
    assert splats.gathered(index).means.tolist() == splats.means[[3, 0]].tolist()
    assert SplatScene(splats).select(index).num_elements == 2
    assert cameras.select(index).names == (cameras.names[3], cameras.names[0])
    anchors = tiny_scene(num_anchors=200)
    assert anchors.select(index).positions.tolist() == anchors.positions[[3, 0]].tolist()
    assert dataset_of(200).select(index).cameras.num_views == 2


def test_masks_and_empty_selections() -> None:
    splats, mask = ball_of_gaussians(), np.arange(200) % 3 == 0
    assert splats.select(mask).means.tolist() == splats.means[mask].tolist()
    assert splats.select(mask.tolist()).num_gaussians == mask.sum()
    assert splats.select([]).num_gaussians == splats.select(np.zeros(0)).num_gaussians == 0


@pytest.mark.parametrize(
    "index",
    [
        np.array([True, False]), np.ones(201, np.bool_), np.zeros(0, np.bool_), [200], [-201], 3, None, "a", [1.0],
        [[1]], [[1], [1, 2]], slice("a", None), slice(None, None, 0),
    ],
)  # fmt: skip
def test_wrong_selections_are_an_error(index) -> None:
    """A mask of another length would select other Gaussians without a word."""
    anchors = tiny_scene(num_anchors=200)
    for chosen in (
        ball_of_gaussians(), SplatScene(ball_of_gaussians()), tiny_cameras(200, 8, 8), anchors, anchors.anchors,
        decoded_coding(), dataset_of(200),
    ):  # fmt: skip
        with pytest.raises(InvalidValueError, match="index: expected"):
            chosen.select(index)


def test_errors_of_selections_name_the_accepted_indices() -> None:
    splats = ball_of_gaussians()
    with pytest.raises(InvalidValueError, match="numbers from -200 to 199, not 200 to 200"):
        splats.select([200])
    with pytest.raises(InvalidValueError, match="expected none, as there are no elements, not 0 to 0"):
        splats.select([]).select([0])


@pytest.fixture(scope="module")
def messages() -> dict[str, str]:
    """Errors of the calls of `wrong_method_arguments`, by name.

    The calls are made in a separate process, without this suite's checks of annotations.
    """
    program = Path(__file__).resolve().parents[1] / "wrong_method_arguments.py"
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", MESSAGES)
def test_wrong_arguments_of_methods_are_one_clear_error(messages: dict[str, str], name: str) -> None:
    assert re.search(f"^InvalidValueError: .*{MESSAGES[name]}", messages[name]), messages[name]


def test_right_arguments_of_methods_are_accepted() -> None:
    received = ReceivedScene(SplatScene(ball_of_gaussians()), LossMask.of_elements(np.ones(200, np.bool_)))
    assert received.masked(np.zeros(200, np.bool_)).loss_mask.num_lost == 200
    assert received.loss_mask.column(Attribute.MASK).all()
    assert tiny_cameras(2, 8, 8).scaled(2.0).width == 16
