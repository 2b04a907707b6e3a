"""Definition of the codec of updates (changes of a stream): a `Schema` with its decoder (docs/format.md)."""

from dataclasses import fields, replace
from typing import Any

from splatwire.bitstream import Manifest, Packetization, SceneStream
from splatwire.bitstream.limits import SCHEMAS, UPDATE
from splatwire.codec.decoding import decode_stream
from splatwire.codec.gaussians.attributes import update_digest
from splatwire.codec.gaussians.decoder import GaussianDecoder, open_side_info
from splatwire.codec.gaussians.encoder import prepare_splats
from splatwire.codec.schema import Options, Prepared, schema_for
from splatwire.codec.update.section import SECTION, read_update
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from splatwire.types.update_scene import UpdateScene


class UpdateDecoder(GaussianDecoder):
    """Decodes the Gaussians that an update adds to a stream.

    Args:
        manifest: The update's manifest.
        side_info: The update's side information, serialised.
        num_bytes: Number of received bytes of the update; not used, but all decoders have this parameter.

    Raises:
        MissingSideInfoError: If the update has no side information.
        BitstreamError: If the side information is damaged or contradicts the manifest, or the section of the update is
            damaged or absent.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        super().__init__(manifest, side_info, num_bytes)
        if SECTION not in self.sections:
            raise BitstreamError(f"the update has no section '{SECTION}', which names the stream that it changes")
        self._fields = read_update(self.sections[SECTION])

    def scene(self) -> ReceivedScene[SplatScene]:
        """Returns the new Gaussians decoded so far, together with the fields of the update (`UpdateFields`)."""
        received = super().scene()
        common = {field.name: getattr(received.scene, field.name) for field in fields(SplatScene)}
        return replace(received, scene=UpdateScene(**common, **self._fields._asdict()))


def _prepare(scene: Any, options: Options) -> Prepared:
    raise InvalidValueError("an update is encoded from a stream and a scene: see `splatwire.encode_update`")


def _prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    info = open_side_info(stream.manifest, stream.side_info)
    scene = decode_stream(stream, threads=threads).scene
    return prepare_splats(scene, Options(packetization, threads=threads), template=info)


SCHEMA = schema_for(
    SCHEMAS[UPDATE],
    scene_type=UpdateScene,
    provides=frozenset((Splats,)),
    prepare=_prepare,
    prepare_repack=_prepare_repack,
    open_decoder=UpdateDecoder,
    update_digest=update_digest,
)
