"""Rendering of HTML reports from a template, with an inlined style sheet."""

from importlib import resources
from typing import Any

from splatwire.version import __version__

_STUDY, _FRAME = "splatwire.evaluation.study", "page.html.jinja"
"""Package of the style sheet, and its template that all pages extend."""


def filled_page(package: str, template: str, **values: Any) -> str:
    """Renders a template, which extends `page.html.jinja`, to a self-contained HTML page.

    Variables of the template that are not given are empty.

    Args:
        package: Name of the Python package that contains the template.
        template: File name of the template.
        **values: Variables of the template, in addition to the style sheet and the package version.
    """
    import jinja2

    def text(folder: str, name: str) -> str:
        return resources.files(folder).joinpath(name).read_text(encoding="utf-8")

    files = {_FRAME: text(_STUDY, _FRAME), template: text(package, template)}
    page = jinja2.Environment(autoescape=True, trim_blocks=True, loader=jinja2.DictLoader(files)).get_template(template)
    return page.render(version=__version__, style=text(_STUDY, "report.css"), **values)
