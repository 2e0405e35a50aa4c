"""The templates of all languages: one environment, and a function that fills a template with a view.

A template lays out text: loops and presence tests. Numbers are counted and expressions written before, in the view.
"""

from __future__ import annotations

from functools import cache

import jinja2

from mbsgen import resources
from mbsgen.targets.entries import write_string


def lay_out(template: str, **view: object) -> str:
    """Fill a template, named by its path in the folder of templates without `.j2`, with the values of its variables."""
    return _environment().get_template(f"{template}.j2").render(view)


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(resources.folder("templates")),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters["c_string"] = write_string
    return environment
