"""Turn the view of a report into one HTML page that needs no other file."""

import json
import re
from html import escape
from importlib.resources import files

from offline.report.view import Section, Table, View

NUMBER = re.compile(r"kg m²|[-+]?\d[\d.e+-]*( .{1,12})?")  # a cell that stays on one line
LONG = 40  # rows; a longer table has its own scroll bar


def page(view: View) -> str:
    """Return the HTML text of a report, with the drawing library inside."""
    charts = json.dumps(view.charts(), allow_nan=False).replace("</", "<\\/")
    sections, count = [], 0
    for place, section in enumerate(view.sections):
        sections.append(_section(place, section, count))
        count += len(section.charts)
    links = "".join(
        f'<a href="#s{place}">{escape(section.title)}</a>'
        for place, section in enumerate(view.sections)
    )
    filled = {
        "title": escape(view.title),
        "class": "valid" if view.valid else "",
        "verdict": escape(view.verdict),
        "links": links,
        "sections": "\n".join(sections),
        "charts": charts,
        "uplot": _file("uplot.js"),
        "uplot_css": _file("uplot_css.txt"),
        "script": _file("page.js"),
    }
    return re.sub(r"@(\w+)@", lambda match: filled[match[1]], _file("page.html"))


def _section(place: int, section: Section, first_chart: int) -> str:
    parts = [f'<section id="s{place}"><h2>{escape(section.title)}</h2>']
    parts += [f"<p>{_shown(text)}</p>" for text in section.text]
    parts += [_table(table) for table in section.tables if table.rows]
    figures = "".join(
        f'<figure data-chart="{first_chart + k}"><figcaption>{escape(chart.title)}</figcaption>'
        "</figure>"
        for k, chart in enumerate(section.charts)
    )
    if figures:
        charts = f'<div class="charts" style="--across:{section.in_rows_of}">{figures}</div>'
        fold = f"<summary>{escape(section.folded)}</summary>"
        parts.append(
            f'<details class="fold">{fold}{charts}</details>' if section.folded else charts
        )
    if section.source:
        source = escape(section.source)
        parts.append(f"<details><summary>Configuration</summary><pre>{source}</pre></details>")
    return "\n".join([*parts, "</section>"])


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(word)}</th>" for word in table.head)
    rows = "".join(
        "<tr>" + "".join(f"<td{_kind(cell)}>{_shown(str(cell))}</td>" for cell in row) + "</tr>"
        for row in table.rows
    )
    body = f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody>"
    kind = "table long" if len(table.rows) > LONG else "table"
    return f'<div class="{kind}"><table>{body}</table></div>'


def _shown(text: str) -> str:
    return escape(text).replace("+-", "±")  # which a terminal or a log need not have


def _kind(cell: object) -> str:
    return ' class="number"' if NUMBER.fullmatch(str(cell)) else ""


def _file(name: str) -> str:
    return files("offline.report").joinpath(name).read_text(encoding="utf-8")
