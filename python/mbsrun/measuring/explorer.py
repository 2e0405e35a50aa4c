"""Panels -> one page of HTML that needs no network and no other file: a dot shows its setting and its command.

Names come from files, so the page only shows them: the template escapes text, and the policy of the page admits only
its own script.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from markupsafe import Markup

from mbsrun.measuring.fronts import Panel, write_error, write_work
from mbsrun.measuring.page import fill_in
from mbsrun.measuring.pictures import draw_alone


def render_explorer(title: str, panels: Sequence[Panel]) -> str:
    """Return the page; the same panels give the same text."""
    shown = [(panel, Markup(_draw(panel, k))) for k, panel in enumerate(panels)]
    return fill_in("explorer", title=title, panels=shown)


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
