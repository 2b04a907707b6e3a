"""Pictures from scenes: one protocol, a compiled CPU renderer, a plain reference, and gsplat where there is a GPU."""

from splatwire.render.base import Renderer as Renderer
from splatwire.render.base import create_renderer as create_renderer
from splatwire.render.base import renderer_names as renderer_names
from splatwire.render.render import iterate_views as iterate_views
from splatwire.render.render import render_scene as render_scene
