"""Layouts with which Foxglove and PlotJuggler show the MCAP file of a report.

Sources: a layout exported by Foxglove (`configById`, mosaic `layout`) and foxglove-sdk's `layouts`;
PlotJuggler 3, `MainWindow::xmlSaveState`, `PlotDocker::xmlSaveState`, `DataLoadMCAP::xmlSaveState`.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any, NamedTuple

from offline.report.series import topic

COLOURS = ("#1f77b4", "#d62728", "#2ca02c")
BAND = {"inertia": 2.0, "lower": 0.5, "upper": 0.5}  # field of a message: width of its line


class Plot(NamedTuple):
    """One plot; each value is a path of keys inside the fields `inertia`, `lower` and `upper`."""

    title: str
    unit: str
    values: tuple[tuple[str, ...], ...]


PLOTS = (
    Plot("mass", "kg", (("m",),)),
    Plot("centre of mass", "m", (("com", "x"), ("com", "y"), ("com", "z"))),
    Plot("moments of inertia", "kg m^2", (("ixx",), ("iyy",), ("izz",))),
    Plot("products of inertia", "kg m^2", (("ixy",), ("ixz",), ("iyz",))),
)


def foxglove(bodies: Sequence[str]) -> str:
    """Return a Foxglove layout (JSON): validity over time, and a row of plots for each body."""
    panels: dict[str, Any] = {"StateTransitions!verdict": _verdict(bodies)}
    rows: list[Any] = []
    for body in bodies:
        names = {f"Plot!{body}{number}": plot for number, plot in enumerate(PLOTS)}
        panels |= {name: _panel(body, plot) for name, plot in names.items()}
        rows.append(_mosaic(list(names), "row"))
    layout = {
        "direction": "column",
        "first": "StateTransitions!verdict",
        "second": _mosaic(rows, "column"),
        "splitPercentage": 15,
    }
    values = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(values | {"playbackConfig": {"speed": 1}}, indent=2) + "\n"


def _verdict(bodies: Sequence[str]) -> dict[str, Any]:
    paths = [
        {"value": f"{topic(body)}.{part}", "label": f"{body} {part}"}
        for body in bodies
        for part in ("valid", "reason")
    ]
    shown = {"enabled": True, "timestampMethod": "receiveTime"}
    return {"isSynced": True, "paths": [path | shown for path in paths]}


def _panel(body: str, plot: Plot) -> dict[str, Any]:
    paths = [
        {
            "value": f"{topic(body)}.{part}.{'.'.join(value)}",
            "label": f"{value[-1]}{'' if part == 'inertia' else f' {part}'}",
            "color": colour,
            "lineSize": width,
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for value, colour in zip(plot.values, COLOURS, strict=False)
        for part, width in BAND.items()
    ]
    return {
        "paths": paths,
        "xAxisVal": "timestamp",
        "yAxisLabel": plot.unit,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "foxglovePanelTitle": f"{body}: {plot.title} [{plot.unit}], 3 sigma",
    }


def _mosaic(items: list[Any], direction: str) -> Any:  # noqa: ANN401
    """Return a tree of two-way splits that gives every item the same share of the space."""
    first, *rest = items
    if not rest:
        return first
    return {
        "direction": direction,
        "first": first,
        "second": _mosaic(rest, direction),
        "splitPercentage": 100.0 / len(items),
    }


def plotjuggler(bodies: Sequence[str], mcap: str) -> str:
    """Return a PlotJuggler layout (XML) of the file `mcap`: a tab of four plots for each body."""
    root = ET.Element("root")
    window = {"name": "Main Window", "parent": "main_window"}
    tabs = ET.SubElement(root, "tabbed_widget", window)
    for body in bodies:
        tab = ET.SubElement(tabs, "Tab", tab_name=body, containers="1")
        columns = _splitter(ET.SubElement(tab, "Container"), "|")
        for left in (PLOTS[:2], PLOTS[2:]):
            column = _splitter(columns, "-")
            for plot in left:
                _area(column, body, plot)
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    loaded = ET.SubElement(root, "previouslyLoaded_Datafiles")
    file = ET.SubElement(loaded, "fileInfo", filename=mcap, prefix="")
    choices = {"use_timestamp": "0", "use_mcap_log_time": "1", "clamp_large_arrays": "0"}
    choices |= {"max_array_size": "500", "selected_topics": ";".join(map(topic, bodies))}
    ET.SubElement(ET.SubElement(file, "plugin", ID="DataLoad MCAP"), "parameters", choices)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _splitter(parent: ET.Element, orientation: str) -> ET.Element:
    shares = {"orientation": orientation, "count": "2", "sizes": "0.5;0.5"}
    return ET.SubElement(parent, "DockSplitter", shares)


def _area(parent: ET.Element, body: str, plot: Plot) -> None:
    area = ET.SubElement(parent, "DockArea", name=f"{plot.title} [{plot.unit}], 3 sigma")
    drawn = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", line_width="1.0")
    ET.SubElement(drawn, "limitY")
    for value, colour in zip(plot.values, COLOURS, strict=False):
        for part in BAND:
            name = "/".join((topic(body), part, *value))
            ET.SubElement(drawn, "curve", name=name, color=colour)
