"""Pictures from scenes: one protocol, a compiled CPU renderer, a plain reference, and gsplat where there is a GPU."""

from splatwire.render.backends import create_renderer, renderer_names
from splatwire.render.base import Renderer
from splatwire.render.render import iterate_views, render_scene

__all__ = [
    "Renderer",
    "create_renderer",
    "iterate_views",
    "render_scene",
    "renderer_names",
]
