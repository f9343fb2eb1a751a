"""`fsw export`: write an identified body in the formats of other tools."""

import argparse
import csv
import io
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.errors import ConfigError
from fsw.messages import FloatArray
from offline.identified_body import AXES, QUANTITIES, Body, body_of, read_result
from offline.parquet import write_parquet
from offline.ros2 import message

PARQUET = "parquet"  # the only binary format


def as_urdf(body: Body) -> str:
    """Return the text of a URDF robot whose only link is the body."""
    root = ET.Element("robot", name=body.name)
    root.append(ET.Comment(" for MuJoCo alone, which keeps the link apart; others skip mujoco "))
    own = ET.SubElement(root, "mujoco")
    ET.SubElement(own, "compiler", fusestatic="false")
    inertial = ET.SubElement(ET.SubElement(root, "link", name=body.name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_words(body.com_m), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(body.mass_kg))
    moments = zip(AXES, body.inertia_kg_m2.tolist(), strict=True)
    ET.SubElement(inertial, "inertia", {f"i{axes}": repr(value) for axes, value in moments})
    return _document(root)


def as_sdf(body: Body) -> str:
    """Return the text of an SDF model whose only link is the body."""
    root = ET.Element("sdf", version="1.9")
    model = ET.SubElement(root, "model", name=body.name)
    inertial = ET.SubElement(ET.SubElement(model, "link", name=body.name), "inertial")
    ET.SubElement(inertial, "pose").text = f"{_words(body.com_m)} 0 0 0"
    ET.SubElement(inertial, "mass").text = repr(body.mass_kg)
    inertia = ET.SubElement(inertial, "inertia")
    for axes, value in zip(AXES, body.inertia_kg_m2.tolist(), strict=True):
        ET.SubElement(inertia, f"i{axes}").text = repr(value)
    return _document(root)


def as_mjcf(body: Body) -> str:
    """Return the text of a MuJoCo model (MJCF) with the body as its only, free body."""
    root = ET.Element("mujoco", model=body.name)
    element = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=body.name)
    ET.SubElement(element, "freejoint")
    xx, xy, xz, yy, yz, zz = body.inertia_kg_m2
    full = _words(np.array([xx, yy, zz, xy, xz, yz]))
    words = {"pos": _words(body.com_m), "mass": repr(body.mass_kg), "fullinertia": full}
    ET.SubElement(element, "inertial", words)
    return _document(root)


def as_json(body: Body) -> str:
    """Return JSON for a controller: values and covariance of mass, centre of mass and inertia."""
    values: dict[str, Any] = {
        "body": body.name,
        "frame": body.frame,
        "valid": body.valid,
        "reason": body.reason,
        "reasons": list(body.reasons),
        "mass_kg": body.mass_kg,
        "com_m": body.com_m.tolist(),
        "inertia_kg_m2": body.inertia_kg_m2.tolist(),
        "quantities": list(QUANTITIES),
        "covariance": body.covariance.tolist(),
    }
    return json.dumps(values, indent=2) + "\n"


def as_csv(body: Body) -> str:
    """Return a CSV table with the columns quantity, value, sigma."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("quantity", "value", "sigma"))
    for row in zip(QUANTITIES, body.values().tolist(), body.sigma().tolist(), strict=True):
        writer.writerow((row[0], repr(row[1]), repr(row[2])))
    return text.getvalue()


def as_ros2(body: Body) -> str:
    """Return inertia_daemon_msgs/msg/BodyEstimate as JSON, which `ros2 topic pub` reads as YAML."""
    return json.dumps(message(body)) + "\n"


def write_body(body: Body, path: Path) -> None:
    """Write a Parquet table with columns quantity, value, sigma, covariance (the quantity's row).

    Raises
    ------
    ConfigError if pyarrow is not installed; OSError when the file cannot be written.
    """
    columns = {
        "quantity": QUANTITIES,
        "value": body.values(),
        "sigma": body.sigma(),
        "covariance": list(body.covariance),
    }
    facts = {"body": body.name, "frame": body.frame, "valid": str(body.valid).lower()}
    write_parquet(path, columns, facts | {"reason": ", ".join(body.reasons)})


FORMATS: dict[str, Callable[[Body], str]] = {
    "urdf": as_urdf,
    "sdf": as_sdf,
    "mjcf": as_mjcf,
    "json": as_json,
    "csv": as_csv,
    "ros2": as_ros2,
}


def export(arguments: argparse.Namespace) -> tuple[Body, str]:
    """Return the requested body and the text for standard output: the body, or the path of `--out`.

    Raises
    ------
    ConfigError when the result has no such body, or the file cannot be written.
    """
    try:
        body = body_of(read_result(arguments.result), arguments.body)
    except ConfigError as error:
        path = str(arguments.result)
        raise ConfigError(str(error) if path in str(error) else f"{path}: {error}") from error
    if arguments.frame is not None:
        body = replace(body, frame=arguments.frame)
    kind, out = arguments.format, arguments.out
    if out is None and kind == PARQUET:
        raise ConfigError("--format parquet: is not text; give --out FILE")
    if out is None:
        return body, FORMATS[kind](body)
    try:
        if kind == PARQUET:
            write_body(body, out)
        else:
            out.write_text(FORMATS[kind](body), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from error
    return body, f"{out}\n"


def _words(values: FloatArray) -> str:
    return " ".join(map(repr, values.tolist()))


def _document(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
