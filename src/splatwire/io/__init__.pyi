from splatwire.io.opening import SceneFile as SceneFile
from splatwire.io.opening import drawable_scene as drawable_scene
from splatwire.io.opening import open_scene as open_scene
from splatwire.io.opening import read_scene_file as read_scene_file
from splatwire.io.saving import save_decoded as save_decoded
from splatwire.io.saving import save_scene as save_scene
