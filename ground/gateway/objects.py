"""The page's tree: a prepared overview, and every point of the dictionary below its packet."""

from collections.abc import Iterator, Sequence
from typing import Any

from ground.gateway.points import EVENTS, Points, TelemetryPoint

SPACE = "inertia"
ROOT, OVERVIEW, EVENT_TABLE = "root", "overview", "event-table"
JOINTS = 7  # number of joints in the overview; the tree has all of them
BODIES = ("target", "base")
TIME = {"key": "utc", "source": "utc", "name": "Time", "format": "utc", "hints": {"domain": 1}}

PLOTS: dict[str, tuple[str, str, tuple[str, ...]]] = {  # name, axis, points
    "target-mass": (
        "Target mass ± 1 sigma",
        "kg",
        (
            "estimate.target_mass_kg",
            "estimate.target_mass_kg_low",
            "estimate.target_mass_kg_high",
        ),
    ),
    "base-mass": (
        "Base mass ± 1 sigma",
        "kg",
        ("estimate.base_mass_kg", "estimate.base_mass_kg_low", "estimate.base_mass_kg_high"),
    ),
    "innovation": ("Innovation: NIS", "NIS", ("estimate.nis", "estimate.nis_dof")),
    "residual-torque": (
        "Residual torque over its declared noise, rms per window",
        "ratio",
        tuple(f"estimate.residual_torque_{k}_ratio" for k in range(1, JOINTS + 1)),
    ),
    "timing": (
        "Scheduler: time of a tick",
        "us",
        ("health.work_last_us", "health.work_mean_us", "health.work_max_us"),
    ),
}
TABLES: dict[str, tuple[str, tuple[str, ...]]] = {
    "now": (
        "Now",
        (
            "health.mode",
            "health.health",
            "health.health_now",
            "estimate.valid",
            "estimate.reason",
            "estimate.target_mass_kg",
            "estimate.target_sigma_mass_kg",
            "estimate.target_com_x_m",
            "estimate.target_com_y_m",
            "estimate.target_com_z_m",
            "estimate.base_mass_kg",
            "estimate.base_sigma_mass_kg",
            "estimate.blocks",
            "estimate.condition_number",
            "estimate.noise_ratio",
            "health.slips",
            "health.max_late_us",
            "recorder.recording",
            "link.tm_dropped",
        ),
    ),
}
COLUMNS: tuple[tuple[int, tuple[tuple[str, int], ...]], ...] = (
    (46, (("target-mass", 40), ("innovation", 30), ("residual-torque", 30))),
    (54, (("now", 48), ("timing", 24), (EVENT_TABLE, 28))),
)
SIDES = ("low", "high")  # suffixes of the bounds of a 1 sigma band
UNIT_NAMES = {"N.m": "nm", "B": "bytes"}  # suffixes of field names that differ from the unit
COLOURS = ("#4d9de0", "#8c98a4", "#8c98a4")  # of a value and of the two bounds of its band


def page_objects(points: Points) -> dict[str, Any]:
    """Return all objects of the page by key (`objects`), and the path of the first (`start`)."""
    found = {item["identifier"]["key"]: item for item in _all(points)}
    return {"objects": found, "start": f"{SPACE}:{ROOT}/{SPACE}:{OVERVIEW}"}


def _all(points: Points) -> Iterator[dict[str, Any]]:
    displays = [*PLOTS, *TABLES, EVENT_TABLE, EVENTS]
    yield _folder(ROOT, "Inertia daemon", [OVERVIEW, *displays, *points.packets])
    yield _overview()
    for key, (name, label, keys) in PLOTS.items():
        yield _plot(key, name, label, [k for k in keys if k in points.by_key])
    for key, (name, keys) in TABLES.items():
        yield _lad_table(key, name, [k for k in keys if k in points.by_key])
    yield from (_events(), _event_table())
    for packet, members in points.packets.items():
        yield _folder(packet, packet.replace("_", " "), [point.key for point in members])
        for point in members:
            yield _point(point)


def _identifier(key: str) -> dict[str, str]:
    return {"namespace": SPACE, "key": key}


def _object(key: str, kind: str, name: str, parent: str) -> dict[str, Any]:
    location = "ROOT" if key == ROOT else f"{SPACE}:{parent}"
    return {"identifier": _identifier(key), "type": kind, "name": name, "location": location}


def _folder(key: str, name: str, members: Sequence[str]) -> dict[str, Any]:
    composition = [_identifier(member) for member in members]
    return _object(key, "folder", name, ROOT) | {"composition": composition}


def _point(point: TelemetryPoint) -> dict[str, Any]:
    name = _words(point)
    value: dict[str, Any] = {
        "key": "value",
        "name": name,
        "unit": point.unit,
        "hints": {"range": 1},
    }
    if point.labels is None:
        value |= {"format": "number", "formatString": "%.6g"}
    else:
        choices = [{"value": number, "string": text} for number, text in point.labels.items()]
        value |= {"format": "enum", "enumerations": choices}
    return _object(point.key, "inertia.point", name, point.packet) | {
        "telemetry": {"values": [value, TIME]},
        "notes": point.doc,
    }


def _words(point: TelemetryPoint) -> str:
    """Return a field's name as words without its unit, which the page shows beside the name."""
    suffix = UNIT_NAMES.get(point.unit, point.unit.replace(".", "_").replace("/", "_"))
    side = next((side for side in SIDES if point.field.endswith(f"_{side}")), "")
    name = (
        point.field.removesuffix(f"_{side}").removesuffix(f"_{suffix}") if suffix else point.field
    )
    return f"{name} {side}".strip().replace("_", " ")


def _events() -> dict[str, Any]:
    words = [
        {"key": key, "name": key.capitalize(), "format": "string", "hints": {"range": k}}
        for k, key in enumerate(("severity", "code", "text"), start=1)
    ]
    return _object(EVENTS, "inertia.events", "Events", ROOT) | {
        "telemetry": {"values": [TIME, *words]}
    }


def _event_table() -> dict[str, Any]:
    return _object(EVENT_TABLE, "table", "Events", ROOT) | {
        "composition": [_identifier(EVENTS)],
        "configuration": {
            "hiddenColumns": {"name": True},
            "columnOrder": ["utc", "severity", "code", "text"],
        },
    }


def _plot(key: str, name: str, label: str, keys: Sequence[str]) -> dict[str, Any]:
    series: list[dict[str, Any]] = [{"identifier": _identifier(member)} for member in keys]
    if len(keys) == len(COLOURS) and "mass" in key:
        series = [
            item | {"color": colour, "markers": place == 0}
            for place, (item, colour) in enumerate(zip(series, COLOURS, strict=True))
        ]
    return _object(key, "telemetry.plot.overlay", name, ROOT) | {
        "composition": [_identifier(member) for member in keys],
        "configuration": {"series": series, "yAxis": {"autoscale": True, "label": label}},
    }


def _lad_table(key: str, name: str, keys: Sequence[str]) -> dict[str, Any]:
    return _object(key, "LadTable", name, ROOT) | {
        "composition": [_identifier(member) for member in keys],
        "configuration": {"hiddenColumns": {"type": True}, "isFixedLayout": False},
    }


def _overview() -> dict[str, Any]:
    members = [key for _, frames in COLUMNS for key, _ in frames]
    containers = [
        {
            "id": f"column-{place}",
            "size": width,
            "frames": [
                {
                    "id": f"frame-{key}",
                    "domainObjectIdentifier": _identifier(key),
                    "size": height,
                    "noFrame": False,
                }
                for key, height in frames
            ],
        }
        for place, (width, frames) in enumerate(COLUMNS)
    ]
    return _object(OVERVIEW, "flexible-layout", "Overview", ROOT) | {
        "composition": [_identifier(member) for member in members],
        "configuration": {"containers": containers, "rowsLayout": False},
    }
