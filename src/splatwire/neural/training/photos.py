"""Store of the training photos, which are kept in memory."""

from collections.abc import Callable

import torch
from jaxtyping import UInt8
from torch import Tensor

from splatwire.data import Dataset
from splatwire.neural.training.photometric_loss import Photo, prepare_photo

PREPARED_BYTES, PREPARED_DEVICE_BYTES = 1 << 30, 4 << 30
"""Maximum bytes of photos kept with precomputed terms of the loss, on the CPU and on a GPU.

For further photos, the terms are computed on each use.
"""
DEVICE_BYTES = 4 << 30
"""Maximum bytes of photos kept on a GPU; further photos are copied from the host on each use."""


class PhotoStore:
    """Photos of a dataset, with the terms of the loss that depend only on the photo.

    Args:
        dataset: The dataset.
        device: The training device.
        prepare: Function that computes these terms (`Kernels.prepare_photo`).
        device_bytes: Maximum bytes of photos on the device.

    Raises:
        DatasetError: If a photo or mask is missing or damaged, or a mask excludes all pixels.
    """

    def __init__(
        self,
        dataset: Dataset,
        device: torch.device,
        prepare: Callable[[Tensor, Tensor | None], Photo] = prepare_photo,
        device_bytes: int = DEVICE_BYTES,
    ) -> None:
        self._device, self._prepare = device, prepare
        pixels = dataset.cameras.width * dataset.cameras.height
        num_on_device = device_bytes // (3 * pixels)
        self._bytes: list[UInt8[Tensor, "H W 3"]] = [
            torch.round(torch.as_tensor(dataset.image(view)) * 255)
            .to(torch.uint8)
            .to(device if view < num_on_device else "cpu")
            for view in range(dataset.num_views)
        ]
        masks = [dataset.mask(view) for view in range(dataset.num_views)]
        self._masks = [None if mask is None else torch.as_tensor(mask) for mask in masks]
        self._prepared: dict[int, Photo] = {}
        max_bytes = PREPARED_BYTES if device.type == "cpu" else PREPARED_DEVICE_BYTES
        self._max_prepared = max_bytes // (3 * pixels * 3 * 4)

    def photo(self, view: int) -> Photo:
        """Returns the photo of a view."""
        if view in self._prepared:
            return self._prepared[view]
        mask = self._masks[view]
        image = self._bytes[view].to(self._device).float() / 255
        photo = self._prepare(image, None if mask is None else mask.to(self._device))
        if len(self._prepared) < self._max_prepared:
            self._prepared[view] = photo
        return photo


def check_photos(dataset: Dataset) -> None:
    """Reads every photo and mask once, to detect damage before the first iteration.

    Raises:
        DatasetError: If a photo or mask is missing or damaged, or a mask excludes all pixels.
    """
    for view in range(dataset.num_views):
        dataset.image(view)
        dataset.mask(view)
