"""`fsw export`: an identified body in the formats of other tools."""

from __future__ import annotations

import csv
import io
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.estimators.model.inertia import (
    NAMES,
    from_parameters,
    nearest_consistent,
    report_jacobian,
    to_parameters,
)
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError

AXES = ("xx", "xy", "xz", "yy", "yz", "zz")
FRAMES = {"base": "base", "target": "tool"}  # of any other body: bodies.NAME.frame
QUANTITIES = ("mass_kg", *(f"com_{a}_m" for a in "xyz"), *(f"inertia_{a}_kg_m2" for a in AXES))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A physically consistent body in its own frame (base: B; target: E; another: its own)."""

    name: str
    mass_kg: float
    com_m: FloatArray  # (3,)
    inertia_kg_m2: FloatArray  # (6,) xx xy xz yy yz zz about the centre of mass
    covariance: FloatArray  # (10, 10) of mass, centre of mass, inertia
    valid: bool

    def values(self) -> FloatArray:
        """Return mass, centre of mass, inertia (10,)."""
        return np.concatenate(([self.mass_kg], self.com_m, self.inertia_kg_m2))


def body_of(result: Mapping[str, Any], name: str | None) -> Body:
    """Return a body of what `fsw identify --json` or `fsw replay --json` printed.

    Raises
    ------
    ConfigError when it holds no such body, or no body at all.
    """
    try:
        known = list(result["estimate"])
        if name is None and len(known) == 1:
            name = known[0]
        if name is None or name not in known:
            raise ConfigError(f"--body {name}: must be one of {', '.join(known) or 'none'}")
        found = result["estimate"][name]
        pi = to_parameters(found["mass_kg"], found["com_m"], found["inertia_kg_m2"])
        places = [result["names"].index(f"{name}.{quantity}") for quantity in NAMES]
        state = np.array(result["covariance"], np.float64)[np.ix_(places, places)]
        valid = bool(result["valid"] if "valid" in result else result["status"] == "OK")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"must be a result of fsw identify --json: {error!r}") from error
    mass, com, inertia = from_parameters(nearest_consistent(pi, state))
    T = report_jacobian(pi)
    return Body(
        name=name,
        mass_kg=mass,
        com_m=com,
        inertia_kg_m2=inertia,
        covariance=T @ state @ T.T,
        valid=valid,
    )


def read_result(path: Path) -> Mapping[str, Any]:
    """Return the values of a result file.

    Raises
    ------
    ConfigError when it cannot be read or is no JSON object.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not a result of fsw identify --json: {error}") from error
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: not a result of fsw identify --json")
    return values


def as_urdf(body: Body) -> str:
    """Return a robot of one link."""
    root = ET.Element("robot", name=body.name)
    own = ET.SubElement(root, "mujoco")  # for MuJoCo alone: keep the link apart from the world
    ET.SubElement(own, "compiler", fusestatic="false")
    inertial = ET.SubElement(ET.SubElement(root, "link", name=body.name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_words(body.com_m), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(body.mass_kg))
    moments = zip(AXES, body.inertia_kg_m2.tolist(), strict=True)
    ET.SubElement(inertial, "inertia", {f"i{axes}": repr(value) for axes, value in moments})
    return _document(root)


def as_sdf(body: Body) -> str:
    """Return a model of one link."""
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
    """Return a model of one free body."""
    root = ET.Element("mujoco", model=body.name)
    element = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=body.name)
    ET.SubElement(element, "freejoint")
    xx, xy, xz, yy, yz, zz = body.inertia_kg_m2
    full = _words(np.array([xx, yy, zz, xy, xz, yz]))
    words = {"pos": _words(body.com_m), "mass": repr(body.mass_kg), "fullinertia": full}
    ET.SubElement(element, "inertial", words)
    return _document(root)


def as_json(body: Body) -> str:
    """Return the payload for a controller: mean and covariance of mass, centre and inertia."""
    values: dict[str, Any] = {
        "body": body.name,
        "frame": FRAMES.get(body.name, "own"),
        "valid": body.valid,
        "mass_kg": body.mass_kg,
        "com_m": body.com_m.tolist(),
        "inertia_kg_m2": body.inertia_kg_m2.tolist(),
        "quantities": list(QUANTITIES),
        "covariance": body.covariance.tolist(),
    }
    return json.dumps(values, indent=2) + "\n"


def as_csv(body: Body) -> str:
    """Return a table: quantity, value, sigma."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("quantity", "value", "sigma"))
    sigma = np.sqrt(np.diag(body.covariance)).tolist()
    for row in zip(QUANTITIES, body.values().tolist(), sigma, strict=True):
        writer.writerow((row[0], repr(row[1]), repr(row[2])))
    return text.getvalue()


FORMATS: dict[str, Callable[[Body], str]] = {
    "urdf": as_urdf,
    "sdf": as_sdf,
    "mjcf": as_mjcf,
    "json": as_json,
    "csv": as_csv,
}


def _words(values: FloatArray) -> str:
    return " ".join(map(repr, values.tolist()))


def _document(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
