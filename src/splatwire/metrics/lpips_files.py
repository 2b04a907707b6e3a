"""Files of the weights of LPIPS, found without torch; nothing is ever downloaded."""

import os
from pathlib import Path

from splatwire.errors import DatasetError, UnknownNameError

WEIGHT_FILES = {
    "vgg": ("vgg16_features.pth", "lpips_lin_vgg.pth"),
    "alex": ("alexnet_features.pth", "lpips_lin_alex.pth"),
}
"""Files of the backbone and of the linear layers in a folder of weights, by network."""


def find_lpips_files(network: str = "vgg") -> tuple[Path, Path] | None:
    """Returns the files of backbone and linear layers that the environment names; None where it names none.

    `SPLATWIRE_LPIPS_BACKBONE` and `SPLATWIRE_LPIPS_LINEAR` name the two files; otherwise `SPLATWIRE_LPIPS_DIR` names a
    folder with `vgg16_features.pth` and `lpips_lin_vgg.pth` (`alexnet_features.pth`, `lpips_lin_alex.pth`).

    Raises:
        DatasetError: The environment names one of the two files only.
        UnknownNameError: No such network.
    """
    if network not in WEIGHT_FILES:
        raise UnknownNameError("LPIPS network", network, WEIGHT_FILES)
    backbone, linear = os.environ.get("SPLATWIRE_LPIPS_BACKBONE"), os.environ.get("SPLATWIRE_LPIPS_LINEAR")
    if backbone and linear:
        return Path(backbone), Path(linear)
    if backbone or linear:
        raise DatasetError("SPLATWIRE_LPIPS_BACKBONE and SPLATWIRE_LPIPS_LINEAR must be set together")
    folder = os.environ.get("SPLATWIRE_LPIPS_DIR")
    if not folder or not (Path(folder) / WEIGHT_FILES[network][0]).exists():
        return None
    return Path(folder) / WEIGHT_FILES[network][0], Path(folder) / WEIGHT_FILES[network][1]
