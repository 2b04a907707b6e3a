"""Import of models trained by other software, through importers of installed packages.

A package announces an importer under the entry-point group `splatwire.importers`: a function that reads a model's
folder and returns a scene.
"""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from splatwire.errors import UnknownNameError
from splatwire.types import AnchorScene

GROUP = "splatwire.importers"
"""Entry-point group of importers in other packages."""


def import_model(kind: str, folder: Path, **options: Any) -> AnchorScene:
    """Reads a model folder written by other training software, and returns the scene.

    Args:
        kind: Name of the importer: `hacpp`, `scaffold`, or that of another package.
        folder: The model folder.
        **options: Options of the importer.

    Raises:
        UnknownNameError: If no importer has that name.
        DatasetError: If the folder does not contain such a model.
    """
    for point in entry_points(group=GROUP, name=kind):
        scene: AnchorScene = point.load()(folder, **options)
        return scene
    raise UnknownNameError("importer", kind, (point.name for point in entry_points(group=GROUP)))
