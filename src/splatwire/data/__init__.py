"""Posed photos and cameras, read from the layouts that datasets are published in."""

from splatwire.data.camera_file import load_cameras, save_cameras
from splatwire.data.dataset import Dataset, dataset_layout, open_dataset
from splatwire.data.photos import load_photo
from splatwire.data.point_cloud import SparsePoints

__all__ = [
    "Dataset",
    "SparsePoints",
    "dataset_layout",
    "load_cameras",
    "load_photo",
    "open_dataset",
    "save_cameras",
]
