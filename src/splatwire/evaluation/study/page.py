"""Rendering of HTML reports from a template, with an inlined style sheet."""

from importlib import resources
from typing import Any

from splatwire.version import __version__


def filled_page(package: str, template: str, **values: Any) -> str:
    """Renders a template to a self-contained page; undefined values are empty.

    Args:
        package: Name of the Python package that contains the template.
        template: File name of the template.
        values: Variables of the template, in addition to the style sheet and the package version.
    """
    import jinja2

    source = resources.files(package).joinpath(template).read_text(encoding="utf-8")
    style = resources.files("splatwire.evaluation.study").joinpath("report.css").read_text(encoding="utf-8")
    page = jinja2.Environment(autoescape=True, trim_blocks=True).from_string(source)
    return page.render(version=__version__, style=style, **values)
