"""A nerfstudio folder of photos; one test view has a mask, and its photo has garbage outside of it."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from splatwire.render import render_scene
from splatwire.types import AnchorScene, Cameras

LEFT = 40
"""Columns inside the mask."""


def write_photos(folder: Path, scene: AnchorScene, cameras: Cameras, garbage: int) -> Path:
    """Renders with noise as photos; the masked part of the first has other noise of the seed `garbage`."""
    for name in ("images", "masks"):
        (folder / name).mkdir(parents=True)
    rng, frames = np.random.default_rng(1), []
    for view, image in enumerate(render_scene(scene, cameras)):
        pixels = (np.clip(image + rng.normal(0, 0.05, image.shape), 0, 1) * 255).round().astype(np.uint8)
        pose = np.linalg.inv(cameras.viewmats[view].astype(np.float64))
        pose[:3, 1:3] *= -1  # OpenGL
        K = cameras.Ks[view].tolist()
        frame = {"file_path": f"images/{view:02d}.png", "transform_matrix": pose.tolist(), "w": cameras.width,
                 "h": cameras.height, "fl_x": K[0][0], "fl_y": K[1][1], "cx": K[0][2], "cy": K[1][2]}  # fmt: skip
        if view == 0:
            mask = np.zeros(image.shape[:2], np.uint8)
            mask[:, :LEFT] = 255
            Image.fromarray(mask).save(folder / "masks" / "00.png")
            frame["mask_path"] = "masks/00.png"
            pixels[:, LEFT:] = np.random.default_rng(garbage).integers(0, 256, pixels[:, LEFT:].shape)
        Image.fromarray(pixels).save(folder / frame["file_path"])
        frames.append(frame)
    (folder / "transforms.json").write_text(json.dumps({"camera_model": "PINHOLE", "frames": frames}))
    return folder
