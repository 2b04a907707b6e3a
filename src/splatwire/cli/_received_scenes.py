"""Decoded output of `splatwire receive`: scenes, frames and previews."""

# Needs libraries that a relay lacks.

from pathlib import Path

from splatwire.api.following import follow
from splatwire.bitstream import SceneStream, write_stream
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.cli._concealers import check_concealer
from splatwire.cli._files import STANDARD, check_folder, output_folder, prepared_output
from splatwire.cli._output import Reporter
from splatwire.cli.receive import Receive
from splatwire.codec import decode_stream
from splatwire.codec.preview import preview_scene
from splatwire.concealment import create_concealer
from splatwire.data import load_cameras
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.evaluation.walkthrough.path import viewpoint_of
from splatwire.files.names import real_path, unused_path
from splatwire.io import save_decoded
from splatwire.io.formats.ply import write_ply
from splatwire.sequence.frame_writer import check_num_frames, write_frames
from splatwire.transport.address import without_token

__all__ = ["follow", "keep_preview", "viewpoint_of_options", "write_scene"]


def viewpoint_of_options(command: Receive) -> Viewpoint | None:
    """Returns the viewpoint of the first camera in the file of the option `--camera`; None without this option."""
    # Checks first that the concealer of `--conceal` exists.
    if command.conceal is not None:
        check_concealer(command.conceal)
    return None if command.camera is None else viewpoint_of(load_cameras(command.camera))


def keep_preview(command: Receive, preview: bytes) -> str:
    """Writes the preview of a scene as a PLY file, because the scene itself did not arrive.

    Args:
        command: Options of `splatwire receive`.
        preview: The received bytes of the preview.

    Returns:
        Sentence on the written or missing preview, for the error message about the transfer.
    """
    try:
        shown = preview_scene(preview)
    except BitstreamError as error:
        return f", and what should have been its {error}"
    if command.output == STANDARD:
        return "; its preview did, but standard output is for the scene: name a file with -o to keep it"
    path = prepared_output(real_path(Path(command.output)).with_suffix(".preview.ply"))
    write_ply([shown.splats], path)
    behind = " ".join(f"{value:.3f}" for value in shown.background)
    return (
        f"; its preview did: {shown.num_elements} Gaussians before {behind} (RGB) -> {path} (if the scene is in map "
        "coordinates, relative to its origin, which did not arrive)"
    )


def write_scene(command: Receive, stream: SceneStream, path: Path, show: Reporter) -> None:
    """Decodes and conceals a received stream, and writes the scene or the frames of the clip.

    Args:
        command: Options of `splatwire receive`.
        stream: The received stream.
        path: Path of the output.
        show: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        InvalidValueError: If the suffix of the output does not fit the kind of scene. The stream is then written to a
            file next to the output.
    """
    explicit = command.explicit
    if stream.manifest.schema.timed and not explicit:
        check_folder(Path(command.output))
        check_num_frames(stream, None, f"receive it to a {FILE_SUFFIX} file, and decode that with --max-frames")
        with output_folder(str(path)) as folder:
            write_frames(stream, folder, ".ply", command.conceal or "", None, show)
        return
    if explicit != stream.manifest.schema.explicit or stream.manifest.schema.timed:
        name = "received" if command.output == STANDARD else command.output
        kept = unused_path(real_path(Path(name)).with_suffix(FILE_SUFFIX))
        write_stream(stream, prepared_output(kept))
        raise InvalidValueError(
            f"{without_token(command.url)} sent {stream.manifest.elements}, which {command.output} is no name for; "
            f"what arrived is in {kept}: `splatwire decode` or `splatwire export` take it from there"
        )
    concealer = None if command.conceal is None else create_concealer(command.conceal)
    save_decoded(decode_stream(stream), concealer, path)
