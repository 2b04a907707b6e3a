"""What the heads say about every possible Gaussian of a scene, whether a view would draw it or not."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.model import AnchorScene


@dataclass(frozen=True, eq=False)
class Slots:
    """The Gaussians that a scene can have: one per anchor and offset that its mask keeps.

    Attributes:
        anchor_index: Its anchor, ascending.
        offset_index: Its offset within the anchor.
        means: Its centre, which no view changes.
    """

    anchor_index: Int64[Tensor, "S"]
    offset_index: Int64[Tensor, "S"]
    means: Float[Tensor, "S 3"]

    @property
    def num_slots(self) -> int:
        """Number of Gaussians, S."""
        return int(self.anchor_index.shape[0])

    def part(self, first: int, last: int) -> "Slots":
        """Returns the Gaussians from `first` to `last` (exclusive)."""
        return Slots(self.anchor_index[first:last], self.offset_index[first:last], self.means[first:last])


@dataclass(frozen=True, eq=False)
class SlotView:
    """What one view makes of some Gaussians.

    Attributes:
        opacities: May be 0 or negative: such a Gaussian is not drawn in this view.
        colors: RGB in [0, 1].
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations, world units.
    """

    opacities: Float[Tensor, "S"]
    colors: Float[Tensor, "S 3"]
    quats: Float[Tensor, "S 4"]
    scales: Float[Tensor, "S 3"]


def slots_of(scene: AnchorScene) -> Slots:
    """Lists the Gaussians that a scene can have; anchors that its hints leave out have none."""
    anchors = scene.anchors
    mask = anchors.mask if scene.hints is None else anchors.mask & ~scene.hints.left_out[:, None]
    anchor_index, offset_index = mask.nonzero().unbind(dim=1)
    offsets = anchors.offsets[anchor_index, offset_index]
    means = anchors.positions[anchor_index] + offsets * anchors.scalings[anchor_index, :3]
    return Slots(anchor_index, offset_index, means)


@torch.no_grad()
def slot_view(scene: AnchorScene, slots: Slots, camera_center: Float[Tensor, "3"]) -> SlotView:
    """Runs the heads for some Gaussians as a camera at `camera_center` sees them (HAC++, decoding of a view)."""
    anchors, heads = scene.anchors, scene.heads
    index, row = torch.unique_consecutive(slots.anchor_index, return_inverse=True)
    offset = slots.offset_index
    ray = anchors.positions[index] - camera_center
    distance = torch.linalg.vector_norm(ray, dim=1, keepdim=True).clamp(min=1e-9)
    inputs = torch.cat([anchors.features[index], ray / distance, distance], dim=1)
    num_offsets = anchors.mask.shape[1]
    shape = heads.covariance(inputs).view(-1, num_offsets, 7)[row, offset]
    scales = anchors.scalings[slots.anchor_index, 3:6] * torch.sigmoid(shape[:, :3])
    opacities = torch.tanh(heads.opacity(inputs))[row, offset]
    if scene.hints is not None:
        scales = scales * scene.hints.size_gain[slots.anchor_index, None]
        if scene.hints.opacity_gain is not None:
            opacities = (opacities * scene.hints.opacity_gain[slots.anchor_index]).clamp(max=1)
    return SlotView(
        opacities=opacities,
        colors=torch.sigmoid(heads.color(inputs).view(-1, num_offsets, 3)[row, offset]),
        quats=torch.nn.functional.normalize(shape[:, 3:7], dim=1),
        scales=scales,
    )
