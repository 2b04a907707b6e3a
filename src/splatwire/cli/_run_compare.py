"""Implementation of `splatwire compare`: compares several files of one scene in a table."""

from splatwire.cli._files import check_folder, check_inputs
from splatwire.cli._output import print_json, print_table, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.cli.compare import Compare
from splatwire.data import load_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluation.comparison import (
    compare_files,
    comparison_cells,
    comparison_content,
    comparison_headings,
    write_comparison_report,
)
from splatwire.render import create_renderer


def run(command: Compare) -> None:
    """Runs `splatwire compare`: compares files of one scene in size and quality."""
    check_inputs(*command.files, command.reference, command.cameras)
    if len(command.files) + (command.reference is not None) < 2:
        raise InvalidValueError("give two files or more, or one file and --reference FILE")
    if command.views is not None and command.views < 1:
        raise InvalidValueError(f"--views must be at least 1, not {command.views}")
    if command.output is not None:
        check_folder(command.output)
    background = chosen_background(command.background)
    create_renderer(command.renderer)
    cameras = None if command.cameras is None else load_cameras(command.cameras)
    with progress_bars() as show:
        comparison = compare_files(
            command.files, reference=command.reference, cameras=cameras, views=command.views,
            renderer=command.renderer, background=background, pictures=command.output is not None, progress=show,
        )  # fmt: skip
    report = None if command.output is None else str(write_comparison_report(comparison, command.output))
    if command.json:
        print_json(comparison_content(comparison) | {"report": report})
        return
    title = f"{comparison.cameras.num_views} views, reference {comparison.reference.name}"
    print_table(comparison_headings(comparison), comparison_cells(comparison), title)
    if report is not None:
        print(f"report: {report}")
