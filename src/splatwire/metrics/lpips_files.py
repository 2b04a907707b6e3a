"""Location of the LPIPS weight files, from environment variables; nothing is downloaded.

The backbones are torchvision's ImageNet weights of VGG16 (`vgg16-397923af.pth`) and AlexNet
(`alexnet-owt-7be5be79.pth`), BSD-3. The linear layers are files of LPIPS v0.1 (`lpips/weights/v0.1/vgg.pth` and
`alex.pth` in the repository richzhang/PerceptualSimilarity), BSD-2.
"""

import os
from pathlib import Path

from splatwire.errors import DatasetError, UnknownNameError

WEIGHT_FILES = {
    "vgg": ("vgg16_features.pth", "lpips_lin_vgg.pth"),
    "alex": ("alexnet_features.pth", "lpips_lin_alex.pth"),
}
"""File names of the backbone and of the linear layers in the folder `SPLATWIRE_LPIPS_DIR`, for each network."""


def find_lpips_files(network: str = "vgg") -> tuple[Path, Path] | None:
    """Returns the paths of the weight files of LPIPS (backbone, linear layers) that environment variables name.

    Either `SPLATWIRE_LPIPS_BACKBONE` and `SPLATWIRE_LPIPS_LINEAR` name the two files, or `SPLATWIRE_LPIPS_DIR` names a
    folder with both files. In the folder, the files are called `vgg16_features.pth` and `lpips_lin_vgg.pth` for the
    network `vgg`, and `alexnet_features.pth` and `lpips_lin_alex.pth` for the network `alex`.

    The result is None if no variable is set, or the folder does not contain the backbone.

    Raises:
        DatasetError: If the environment names only one of the two files.
        UnknownNameError: If the network does not exist.
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
