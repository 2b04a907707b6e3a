"""One HTML file out of a template, with its style sheet in it: what every report is."""

from importlib import resources
from typing import Any

import splatwire


def filled_page(room: str, template: str, **values: Any) -> str:
    """Fills a template; what it is not given stays out of it.

    Args:
        room: Package that the template lies in.
        template: Its file name.
        values: What it shows, beside the style sheet and the version of this package.
    """
    import jinja2

    source = resources.files(room).joinpath(template).read_text(encoding="utf-8")
    style = resources.files("splatwire.evaluate.study").joinpath("report.css").read_text(encoding="utf-8")
    page = jinja2.Environment(autoescape=True, trim_blocks=True).from_string(source)
    return page.render(version=splatwire.__version__, style=style, **values)
