from splatwire.data.camera_file import load_cameras as load_cameras
from splatwire.data.camera_file import save_cameras as save_cameras
from splatwire.data.dataset import Dataset as Dataset
from splatwire.data.dataset import dataset_layout as dataset_layout
from splatwire.data.dataset import open_dataset as open_dataset
from splatwire.data.photos import load_photo as load_photo
from splatwire.data.point_cloud import SparsePoints as SparsePoints
