import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

MODEL_IDS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "EQUIRECTANGULAR": 17}


class Capture:
    """Twelve posed images of 40 x 24 pixels, which can be written in any dataset layout."""

    width, height, focal = 40, 24, (33.0, 35.0)

    def __init__(self, root: Path) -> None:
        rng = np.random.default_rng(1)
        self.root = root
        self.names = [f"view_{i:02d}.png" for i in (3, 0, 7, 1, 11, 2, 10, 4, 5, 9, 6, 8)]
        quaternions = rng.normal(size=(12, 4))
        self.quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        self.translations = rng.normal(size=(12, 3))
        self.points = rng.normal(size=(5, 3))
        self.colors = rng.integers(0, 256, (5, 3))
        self.pixels = rng.integers(0, 256, (12, self.height, self.width, 3)).astype(np.uint8)

    def viewmat(self, i: int) -> np.ndarray:
        """World-to-camera matrix of view `i`: rotates a vector v by q v q*, expanded into quaternion products."""

        def product(a, b):
            (w, *v), (s, *u) = a, b
            v, u = np.array(v), np.array(u)
            return np.array([w * s - v @ u, *(w * u + s * v + np.cross(v, u))])

        q = self.quaternions[i]
        conjugate = q * [1, -1, -1, -1]
        matrix = np.eye(4)
        for axis in range(3):
            matrix[:3, axis] = product(product(q, [0, *np.eye(3)[axis]]), conjugate)[1:]
        matrix[:3, 3] = self.translations[i]
        return matrix

    @property
    def sorted_views(self) -> list[int]:
        return sorted(range(12), key=lambda i: self.names[i])

    def write_images(self, folder: str = "images", size: tuple[int, int] | None = None) -> None:
        (self.root / folder).mkdir(parents=True, exist_ok=True)
        for name, pixels in zip(self.names, self.pixels, strict=True):
            image = Image.fromarray(pixels)
            (image.resize(size) if size else image).save(self.root / folder / name)

    def write_binary(self, model: str = "PINHOLE", parameters: tuple[float, ...] | None = None) -> Path:
        folder = self.root / "sparse" / "0"
        folder.mkdir(parents=True, exist_ok=True)
        parameters = parameters or (*self.focal, self.width / 2, self.height / 2)
        camera = struct.pack("<IiQQ", 7, MODEL_IDS[model], self.width, self.height)
        camera += struct.pack(f"<{len(parameters)}d", *parameters)
        (folder / "cameras.bin").write_bytes(struct.pack("<Q", 1) + camera)
        images = struct.pack("<Q", 12)
        for i, name in enumerate(self.names):
            images += struct.pack("<I7dI", i + 1, *self.quaternions[i], *self.translations[i], 7)
            images += name.encode() + b"\0" + struct.pack("<Q", i % 3) + b"\7" * 24 * (i % 3)
        (folder / "images.bin").write_bytes(images)
        points = struct.pack("<Q", 5)
        for i in range(5):
            points += struct.pack("<Q3d3Bd", i, *self.points[i], *self.colors[i], 0.5)
            points += struct.pack("<Q", i) + b"\1" * 8 * i
        (folder / "points3D.bin").write_bytes(points)
        return folder

    def write_text(self) -> Path:
        folder = self.root / "sparse" / "0"
        folder.mkdir(parents=True, exist_ok=True)
        fx, fy = self.focal
        (folder / "cameras.txt").write_text(f"# a comment\n7 PINHOLE 40 24 {fx} {fy} 20 12\n")
        lines = ["# two lines per image"]
        for i, name in enumerate(self.names):
            pose = " ".join(repr(float(v)) for v in (*self.quaternions[i], *self.translations[i]))
            lines += [f"{i + 1} {pose} 7 {name}", "1.0 2.0 -1" if i % 2 else ""]
        (folder / "images.txt").write_text("\n".join(lines) + "\n")
        rows = [
            f"{i} {' '.join(map(repr, map(float, self.points[i])))} {' '.join(map(str, self.colors[i]))} 0.5 1 2"
            for i in range(5)
        ]
        (folder / "points3D.txt").write_text("\n".join(rows) + "\n")
        return folder

    def c2w_opengl(self, i: int) -> list[list[float]]:
        """Camera-to-world matrix of view `i`, with y up and z backward."""
        pose = np.linalg.inv(self.viewmat(i))
        pose[:3, 1:3] *= -1
        return pose.tolist()

    def write_blender(self) -> Path:
        angle = 2 * math.atan(self.width / 2 / self.focal[0])
        for half, views in (("train", range(8)), ("test", range(8, 12))):
            (self.root / half).mkdir(parents=True, exist_ok=True)
            frames = []
            for i in views:
                alpha = np.full((self.height, self.width, 1), 51 * (i % 6), dtype=np.uint8)
                Image.fromarray(np.concatenate([self.pixels[i], alpha], axis=2)).save(self.root / half / f"r_{i}.png")
                frames.append({"file_path": f"./{half}/r_{i}", "transform_matrix": self.c2w_opengl(i)})
            content = {"camera_angle_x": angle, "frames": frames}
            (self.root / f"transforms_{half}.json").write_text(json.dumps(content))
        return self.root

    def write_nerfstudio(self, **extra: object) -> Path:
        self.write_images()
        fx, fy = self.focal
        frames = [
            {"file_path": f"images/{name}", "transform_matrix": self.c2w_opengl(i)} for i, name in enumerate(self.names)
        ]
        content = {"fl_x": fx, "fl_y": fy, "cx": 19.5, "cy": 12.25, "w": 40, "h": 24, "k1": 0.0, "frames": frames}
        (self.root / "transforms.json").write_text(json.dumps({**content, **extra}))
        return self.root

    def write_bungee(self, **extra: object) -> Path:
        self.write_images()
        rows = []
        for i in self.sorted_views:
            table = np.zeros((3, 5))
            table[:, :4] = np.array(self.c2w_opengl(i))[:3]
            table[:, 4] = self.height, self.width, self.focal[0]
            rows.append([*table.flatten().tolist(), 0.1, 9.0])
        content = {"poses": rows, "scene_scale": 0.01, "scene_origin": [0.0, 0.0, -6371011.0], "scale_split": [8, 4, 0]}
        (self.root / "poses_enu.json").write_text(json.dumps({**content, **extra}))
        return self.root


@pytest.fixture
def capture(tmp_path) -> Capture:
    return Capture(tmp_path / "scene")
