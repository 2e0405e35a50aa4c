"""Panels -> one page of HTML that needs no network and no other file: a dot shows its setting and its command.

Names come from files, so the page only shows them: the template escapes text, and the policy of the page admits only
its own script.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from mbsgen import resources
from mbsrun.measuring.fronts import Panel, write_error, write_work
from mbsrun.measuring.pictures import draw_alone


def render_explorer(title: str, panels: Sequence[Panel]) -> str:
    """Return the page; the same panels give the same text."""
    folder = resources.folder("templates") / "html"
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script = (folder / "explorer.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    shown = [(panel, Markup(_draw(panel, k))) for k, panel in enumerate(panels)]
    return environment.get_template("explorer.html").render(
        title=title,
        panels=shown,
        script=Markup(script),
        script_hash=f"sha256-{digest}",
    )


def _draw(panel: Panel, number: int) -> str:
    """Return a panel as SVG, whose dots hold their text as data."""
    svg = draw_alone(panel, f"p{number}d")
    svg = svg[svg.index("<svg") :]
    for k, dot in enumerate(panel.dots):
        if dot.is_good:
            work, error = dot.place
            text = [dot.name, f"{write_work(work, panel.unit)}, error {write_error(error)}", dot.command]
            data = Markup.escape(json.dumps(text, ensure_ascii=False))
            svg = svg.replace(f'<g id="p{number}d{k}">', f'<g id="p{number}d{k}" data-dot="{data}">')
    return svg
