"""Calls methods of scenes, Gaussians, cameras and loss masks with wrong arguments, and prints the errors as JSON.

Runs as a program, because the suite's checks of annotations would precede those of the package.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from explicit import ball_of_gaussians
from scenes import tiny_cameras, tiny_scene
from splatwire.channel import parse_loss
from splatwire.data.dataset import Dataset
from splatwire.types import LossMask, ReceivedScene, SplatCoding, SplatScene
from splatwire.types.scene import RenderHints

MESSAGES = {
    "with_elements scene": "elements: expected Splats",
    "with_elements anchors": "elements: expected Splats",
    "with_elements of anchors": "elements: expected Anchors",
    "with_elements hints": "hints.size_gain is for 3 elements",
    "with_elements text": "elements: expected Splats",
    "degree text": "degree 0 to 3 are supported, not '1'",
    "degree float": "degree 0 to 3 are supported, not 1.5",
    "degree None": "degree 0 to 3 are supported, not None",
    "degree high": "degree 0 to 3 are supported, not 4",
    "center shape": r"camera_center: expected an array \(3,\)",
    "center text": r"camera_center: expected an array \(3,\)",
    "center cameras": r"camera_center: expected an array \(3,\)",
    "center NaN": "camera_center: expected three finite numbers",
    "scaled text": "factor: expected a number",
    "scaled 0": "factor: expected a finite number above 0, not 0",
    "scaled infinite": "factor: expected a finite number above 0, not inf",
    "scaled large": "factor: 1e.300 exceeds the limit",
    "relative_to number": "an origin is three numbers",
    "relative_to shape": "an origin is three numbers",
    "relative_to NaN": "an origin is three numbers",
    "moved_origin": "an origin is three numbers",
    "column number": "attribute: expected an Attribute .FEATURE",
    "column text": "attribute: expected an Attribute .FEATURE",
    "of_elements": r"fully_received: expected an array \(N,\) of True and False",
    "masked length": r"fully_received: expected an array \(200,\)",
    "masked type": r"fully_received: expected an array \(200,\)",
    "masked loss": r"fully_received: expected an array \(200,\)",
    "record": "kind: expected a class",
    "with_losses": r"fully_received: expected a bool array \(200,\)",
    "estimates": "loss_mask: expected LossMask",
    "empty": "count must be a whole number of 0 or more, not -1",
    "coding": "coding is for 200 Gaussians",
    "select long integer": "index: expected whole numbers .* not an integer of 16610 bits",
    "column array": "attribute: expected an Attribute .FEATURE",
    "received": "rng: expected Generator",
    "over": "other: expected SceneMetadata",
    "image": "view must be a whole number of at most 1, not 2",
    "anchors lost": r"positions: expected a float32 array \(20, 3\)",
    "estimates of others": "estimates: Gaussians with",
    "anchor estimates": "estimates: arrays of shapes",
    "fill": "source: 200 Gaussians of degree . do not fit",
}
"""Expected error of each call, a regular expression."""


def calls() -> dict[str, Callable[[], Any]]:
    """Returns calls with wrong arguments by name."""
    scene, cameras, anchors = SplatScene(ball_of_gaussians()), tiny_cameras(2, 8, 8), tiny_scene(num_anchors=20)
    splats, received = scene.splats, ReceivedScene(scene, LossMask.of_elements(np.ones(200, np.bool_)))
    hints = RenderHints(np.ones(3, np.float32), np.zeros(3, np.bool_))
    coding = SplatCoding(0, 0, 0, (0,), np.zeros((1, 1), np.int64), np.zeros(200, np.uint8))
    known: Any = np.ones(20, np.bool_)
    return {
        "with_elements scene": lambda: scene.with_elements(scene),
        "with_elements anchors": lambda: scene.with_elements(anchors.anchors),
        "with_elements of anchors": lambda: anchors.with_elements(splats),
        "with_elements hints": lambda: scene.with_elements(splats, hints),
        "with_elements text": lambda: scene.with_elements("a"),
        "degree text": lambda: splats.at_most_degree("1"),
        "degree float": lambda: splats.at_most_degree(1.5),
        "degree None": lambda: splats.at_most_degree(None),
        "degree high": lambda: splats.at_most_degree(4),
        "center shape": lambda: splats.seen_from(np.zeros(4)),
        "center text": lambda: splats.seen_from("a"),
        "center cameras": lambda: splats.seen_from(cameras),
        "center NaN": lambda: splats.seen_from([0, 0, np.nan]),
        "scaled text": lambda: cameras.scaled("2"),
        "scaled 0": lambda: cameras.scaled(0),
        "scaled infinite": lambda: cameras.scaled(np.inf),
        "scaled large": lambda: cameras.scaled(1e300),
        "relative_to number": lambda: cameras.relative_to(3),
        "relative_to shape": lambda: cameras.relative_to((1.0, 2.0)),
        "relative_to NaN": lambda: cameras.relative_to((1.0, 2.0, np.nan)),
        "moved_origin": lambda: splats.moved_origin((0.0, 0.0, 0.0), None),
        "column number": lambda: received.loss_mask.column(4),
        "column text": lambda: received.loss_mask.column("FEATURE"),
        "of_elements": lambda: LossMask.of_elements("a"),
        "select long integer": lambda: splats.select(10**5000),
        "column array": lambda: received.loss_mask.column(np.zeros(2)),
        "received": lambda: parse_loss("bernoulli:0.2").received(3, None),
        "over": lambda: scene.metadata.over({}),
        "image": lambda: Dataset(cameras, (Path("a.png"), Path("b.png"))).image(2),
        "masked length": lambda: received.masked(np.ones(3, np.bool_)),
        "masked type": lambda: received.masked(np.ones(200)),
        "masked loss": lambda: received.masked(received.loss_mask),
        "record": lambda: received["sketch"],  # type: ignore[index]
        "with_losses": lambda: splats.with_losses(None, scene.positions),
        "anchors lost": lambda: anchors.anchors.with_losses(known, None),
        "estimates": lambda: splats.with_estimates(received, splats),
        "estimates of others": lambda: splats.with_estimates(received.loss_mask, splats.select([1])),
        "anchor estimates": lambda: anchors.anchors.with_estimates(
            LossMask.of_elements(known), anchors.anchors.select([1])
        ),
        "fill": lambda: splats.fill(199, splats),
        "empty": lambda: splats.empty(-1, 0),
        "coding": lambda: SplatScene(splats.select([1]), coding=coding),
    }


def error_of(call: Callable[[], Any]) -> str:
    """Returns the type and message of the error of a call; empty without one."""
    try:
        call()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


if __name__ == "__main__":
    print(json.dumps({name: error_of(call) for name, call in calls().items()}))
