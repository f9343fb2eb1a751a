"""The estimate over time and its layouts, read as Foxglove and PlotJuggler read them."""

import json
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from fsw.errors import ConfigError
from fsw.estimators.model.inertia import NAMES, from_parameters, report_jacobian, to_parameters
from fsw.exchange.recording_writer import schema_of
from fsw.messages import BodyEstimate, Estimate
from offline.report import write_report
from offline.report.layouts import PLOTS, foxglove, plotjuggler
from offline.report.series import SCHEMA, write_series

BODIES = ("base", "target")
END_NS = 7_000_000_123
SCALARS = {"boolean", "string", "number", "integer"}


def estimate(t_ns, nis):
    pi = {
        "base": to_parameters(900.0, [0.1, 0.0, -0.2], [100.0, 2.0, -3.0, 120.0, 1.0, 90.0]),
        "target": to_parameters(80.0, [0.0, 0.3, 0.1], [6.0, 0.3, -0.2, 5.0, 0.1, 4.0]),
    }
    names = ["joint.offset", *(f"{body}.{name}" for body in BODIES for name in NAMES)]
    factor = np.random.default_rng(5).normal(size=(21, 21)) * 1e-2
    covariance = factor @ factor.T
    bodies = {}
    for place, body in enumerate(BODIES):
        mass, com, inertia = from_parameters(pi[body])
        own = slice(1 + 10 * place, 11 + 10 * place)
        J = report_jacobian(pi[body])
        sigma = np.sqrt(np.diag(J @ covariance[own, own] @ J.T))
        bodies[body] = BodyEstimate(
            mass_kg=mass,
            com_m=com,
            inertia_kg_m2=inertia,
            mass_sigma_kg=float(sigma[0]),
            com_sigma_m=sigma[1:4],
            inertia_sigma_kg_m2=sigma[4:],
            physically_consistent=True,
        )
    return Estimate(
        t_ns=t_ns,
        reasons=() if t_ns == END_NS else ("TOO_FEW_BLOCKS",),
        method="fused",
        names=tuple(names),
        mean=np.concatenate([[0.0], *pi.values()]),
        covariance=covariance,
        bodies=bodies,
        blocks=3,
        gated=1,
        nis=nis,
        nis_dof=60,
        condition_number=1e3,
        information_gained_nats=5.0,
    )


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """Return the estimates, and the channels of the file with their messages by topic."""
    estimates = [estimate(6_000_000_000, float("nan")), estimate(END_NS, 55.0)]
    path = tmp_path_factory.mktemp("series") / "x_estimate.mcap"
    write_series(estimates, BODIES, path)
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        statistics = reader.get_summary().statistics
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert json.loads(schema.data) == SCHEMA
            found.setdefault(channel.topic, []).append((message, json.loads(message.data)))
    assert statistics.message_count == 4
    return estimates, found


def test_every_message_keeps_the_schema(held):
    Draft202012Validator.check_schema(SCHEMA)
    validator = Draft202012Validator(SCHEMA)
    for messages in held[1].values():
        for _, values in messages:
            validator.validate(values)
    with pytest.raises(Exception, match="covariance"):
        validator.validate(values | {"covariance": values["covariance"][:99]})


def test_a_message_holds_estimate_sigma_and_stamp(held):
    estimates, found = held
    assert set(found) == {"/estimate/base", "/estimate/target"}
    for source, (record, values) in zip(estimates, found["/estimate/target"], strict=True):
        body, stamp = source.bodies["target"], values["header"]["stamp"]
        assert record.log_time == stamp["sec"] * 10**9 + stamp["nanosec"] == source.t_ns
        assert (values["valid"], values["reason"]) == (source.valid, source.reason)
        assert values["inertia"]["m"] == pytest.approx(body.mass_kg, rel=1e-12)
        assert values["inertia"]["com"]["y"] == pytest.approx(body.com_m[1], rel=1e-12)
        assert values["inertia"]["ixz"] == pytest.approx(body.inertia_kg_m2[2], rel=1e-12)
        assert values["sigma"]["izz"] == pytest.approx(body.inertia_sigma_kg_m2[5], rel=1e-9)
        above = values["upper"]["com"]["x"] - values["inertia"]["com"]["x"]
        assert above == pytest.approx(3.0 * body.com_sigma_m[0], rel=1e-9)
        below = values["inertia"]["m"] - values["lower"]["m"]
        assert below == pytest.approx(3.0 * body.mass_sigma_kg, rel=1e-9)
    assert "nis" not in found["/estimate/target"][0][1], "JSON has no NaN"
    assert found["/estimate/target"][1][1]["nis"] == 55.0


def foxglove_reads(schema):
    """Raise what Foxglove's parser of JSON Schema does not support (@foxglove/mcap-support)."""
    assert schema["type"] == "object", schema
    for name, part in schema.get("properties", {}).items():
        if part["type"] == "object":
            foxglove_reads(part)
        elif part["type"] == "array" and part["items"]["type"] == "object":
            foxglove_reads(part["items"])
        else:
            kind = part["items"]["type"] if part["type"] == "array" else part["type"]
            assert kind in SCALARS, name


@pytest.mark.parametrize(
    "schema", [SCHEMA, *map(schema_of, ("/estimate", "/events", "/tm", "/tc"))]
)
def test_foxglove_supports_the_schemas_of_exports_and_recordings(schema):
    foxglove_reads(schema)


def test_every_series_of_the_foxglove_layout_is_in_every_message(held):
    layouts = pytest.importorskip("foxglove.layouts", reason="needs foxglove-sdk: sh tests/setup")
    layout = json.loads(foxglove(BODIES))
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    known = {
        "Plot": (layouts.PlotConfig(), layouts.PlotSeries()),
        "StateTransitions": (layouts.StateTransitionsConfig(), layouts.StateTransitionsSeries()),
    }
    shown = set()
    for name, panel in panels.items():
        config, series = (set(part._to_dict()) for part in known[name.split("!")[0]])
        assert set(panel) - {"foxglovePanelTitle"} <= config
        for path in panel["paths"]:
            assert set(path) <= series
            topic, *fields = path["value"].split(".")
            shown.add(path["value"])
            for _, values in held[1][topic]:
                for field in fields:
                    values = values[field]  # noqa: PLW2901
                assert isinstance(values, float if name.startswith("Plot") else bool | str)
    assert len(shown) == 2 * (2 + 3 * 10), "verdict, and mean and bounds of ten values, twice"


def leaves(tree):
    """Return the panels of a mosaic."""
    if isinstance(tree, str):
        return [tree]
    assert tree["direction"] in ("row", "column")
    assert 0 < tree["splitPercentage"] < 100
    return [*leaves(tree["first"]), *leaves(tree["second"])]


def flat(name, value):
    """Return the names of the series that PlotJuggler makes of JSON (nlohmann_parsers.cpp)."""
    if isinstance(value, dict):
        return {found for key, part in value.items() for found in flat(f"{name}/{key}", part)}
    if isinstance(value, list):
        return {found for k, part in enumerate(value) for found in flat(f"{name}[{k}]", part)}
    return {name} if isinstance(value, bool | int | float) else set()


def test_plotjuggler_finds_file_channels_and_every_curve(held):
    root = ET.fromstring(plotjuggler(BODIES, "x_estimate.mcap"))
    assert root.tag == "root"
    window = root.find("tabbed_widget")
    assert window is not None
    assert (window.get("name"), window.get("parent")) == ("Main Window", "main_window")
    assert [tab.get("tab_name") for tab in window.findall("Tab")] == list(BODIES)
    for splitter in window.iter("DockSplitter"):
        shares = splitter.get("sizes", "").split(";")
        assert splitter.get("orientation") in ("|", "-")
        assert len(splitter) == int(splitter.get("count", "")) == len(shares)
        assert {part.tag for part in splitter} <= {"DockSplitter", "DockArea"}
    areas = list(window.iter("DockArea"))
    assert len(areas) == len(PLOTS) * len(BODIES)
    assert all(area.find("plot") is not None for area in areas)
    series = {name for topic, held_ in held[1].items() for name in flat(topic, held_[0][1])}
    curves = {curve.get("name") for curve in window.iter("curve")}
    assert curves <= series
    assert len(curves) == 2 * 3 * 10
    loaded = root.find("previouslyLoaded_Datafiles/fileInfo")
    assert loaded is not None
    assert loaded.get("filename") == "x_estimate.mcap"
    parameters = loaded.find("plugin[@ID='DataLoad MCAP']/parameters")
    assert parameters is not None
    assert parameters.get("selected_topics", "").split(";") == list(held[1])


def test_parquet_is_refused_before_the_replay_where_it_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    arguments = (tmp_path / "none.mcap", None, tmp_path / "none.html")
    with pytest.raises(ConfigError, match="pip install"):
        write_report(*arguments, with_parquet=True)
