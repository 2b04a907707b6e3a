from splatwire.io.opening import LoadedScene as LoadedScene
from splatwire.io.opening import drawable_scene as drawable_scene
from splatwire.io.opening import open_scene as open_scene
from splatwire.io.opening import read_any_scene as read_any_scene
from splatwire.io.saving import save_decoded as save_decoded
from splatwire.io.saving import save_scene as save_scene
