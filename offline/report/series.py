"""Write the estimate over time as an MCAP file with JSON Schema, one channel for each body.

A message is inertia_daemon_msgs/msg/BodyEstimate with 1 sigma and the bounds mean -+ 3 sigma added.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from fsw.exchange.status import body_values, finite
from fsw.messages import Estimate
from offline.identified_body import AXES, Body, body_of
from offline.ros2 import inertia, message

NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
BAND_SIGMAS = 3.0
NAME = "inertia_daemon_msgs/BodyEstimate"


def _object(required: dict[str, Any], optional: dict[str, Any] | None = None) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": required | (optional or {}),
        "required": list(required),
        "additionalProperties": False,
    }


_INERTIA = _object(
    {
        "m": NUMBER | {"description": "kg"},
        "com": _object({axis: NUMBER | {"description": "m"} for axis in "xyz"}),
        **{f"i{axes}": NUMBER | {"description": "kg m^2, about com"} for axes in AXES},
    }
)
SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    **_object(
        {
            "header": _object(
                {"stamp": _object({"sec": INTEGER, "nanosec": INTEGER}), "frame_id": TEXT}
            ),
            "body": TEXT,
            "valid": {"type": "boolean"},
            "reason": TEXT
            | {"description": "why not valid, the most severe first; empty when valid"},
            "inertia": _INERTIA,
            "covariance": {
                "type": "array",
                "items": NUMBER,
                "minItems": 100,
                "maxItems": 100,
                "description": "(10, 10) by rows: m, com.x, .y, .z, ixx, ixy, ixz, iyy, iyz, izz",
            },
            "sigma": _INERTIA,
            "lower": _INERTIA | {"description": "inertia minus 3 sigma"},
            "upper": _INERTIA | {"description": "inertia plus 3 sigma"},
            "blocks": INTEGER | {"description": "windows used"},
            "gated": INTEGER | {"description": "windows left out"},
        },
        {"nis": NUMBER | {"description": "of the newest window"}, "nis_dof": INTEGER},
    ),
}


def topic(body: str) -> str:
    """Return the name of a body's channel."""
    return f"/estimate/{body}"


def write_series(estimates: Sequence[Estimate], bodies: Sequence[str], path: Path) -> None:
    """Write the estimates of the bodies to an MCAP file, stamped with the end of their window.

    Raises
    ------
    OSError when the file cannot be written.
    """
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="fsw")
        schema = writer.register_schema(NAME, "jsonschema", json.dumps(SCHEMA).encode())
        channels = {body: writer.register_channel(topic(body), "json", schema) for body in bodies}
        for sequence, estimate in enumerate(estimates):
            for name, channel in channels.items():
                data = json.dumps(_values(estimate, _body(estimate, name)), allow_nan=False)
                t_ns = estimate.t_ns
                writer.add_message(channel, t_ns, data.encode(), t_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _body(estimate: Estimate, name: str) -> Body:
    return body_of(
        {
            "estimate": {name: body_values(estimate.bodies[name])},
            "names": estimate.names,
            "covariance": estimate.covariance,
            "valid": estimate.valid,
            "reason": ", ".join(estimate.reasons),
        },
        name,
    )


def _values(estimate: Estimate, body: Body) -> dict[str, Any]:
    mean, sigma = body.values(), body.sigma()
    nis = finite(estimate.nis)
    return {
        **message(body, estimate.t_ns),
        "sigma": inertia(sigma),
        "lower": inertia(mean - BAND_SIGMAS * sigma),
        "upper": inertia(mean + BAND_SIGMAS * sigma),
        "blocks": estimate.blocks,
        "gated": estimate.gated,
        **({} if nis is None else {"nis": nis, "nis_dof": estimate.nis_dof}),
    }
