from splatwire.render.backends import create_renderer as create_renderer
from splatwire.render.backends import renderer_names as renderer_names
from splatwire.render.base import Renderer as Renderer
from splatwire.render.pictures import Pictures as Pictures
from splatwire.render.render import iterate_views as iterate_views
from splatwire.render.render import render_scene as render_scene
