"""Paths of the example scene that is included in the package."""

from importlib import resources
from pathlib import Path

ASSETS = Path(str(resources.files("splatwire").joinpath("assets")))
SCENE, SPLATS, CAMERAS = "snowmiku.swz", "snowmiku_gaussians.swz", "snowmiku_cameras.json"
"""File names: stream of anchors, stream of explicit Gaussians, and cameras for both."""
