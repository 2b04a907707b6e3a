"""Content of a file of explicit Gaussians: the Gaussians, and statements about all of them."""

from dataclasses import dataclass, replace

from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.origin import NO_ORIGIN, Origin, choose_origin
from splatwire.scene.splats import Splats


@dataclass(frozen=True, eq=False)
class FileContent:
    """Content of a file of explicit Gaussians.

    Attributes:
        splats: The Gaussians; positions are relative to `origin`.
        origin: World coordinates that positions are relative to.
        antialiased: True if the file says that Gaussians lose opacity as they are widened to a pixel.
        metadata: Metadata of the scene; its view is relative to `origin`, too.
    """

    splats: Splats
    origin: Origin = NO_ORIGIN
    antialiased: bool = False
    metadata: SceneMetadata = NO_METADATA

    def relative_to(self, origin: Origin) -> "FileContent":
        """Returns the same content with positions relative to another origin."""
        return replace(
            self,
            splats=self.splats.moved_origin(self.origin, origin),
            origin=origin,
            metadata=self.metadata.moved_origin(self.origin, origin),
        )

    def with_chosen_origin(self) -> "FileContent":
        """Returns the same content with an origin near the Gaussians where `choose_origin` finds one."""
        if self.origin != NO_ORIGIN:
            return self
        return self.relative_to(choose_origin(self.splats.means, wide=False))
