"""ROS 2: write the package `inertia_daemon_msgs` and the message for an identified body.

Source: BodyEstimate.msg beside this file; geometry_msgs/Inertia of ROS 2 common_interfaces.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

from fsw.errors import ConfigError
from fsw.messages import FloatArray
from offline.identified_body import AXES, Body

PACKAGE = {"BodyEstimate.msg": "msg", "package.xml": "", "CMakeLists.txt": ""}  # file: folder


def message(body: Body, t_ns: int = 0) -> dict[str, Any]:
    """Return a body as the values of inertia_daemon_msgs/msg/BodyEstimate.

    Parameters
    ----------
    t_ns : stamp, the end of the last window used [ns]; 0: unknown
    """
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    return {
        "header": {"stamp": stamp, "frame_id": body.frame},
        "body": body.name,
        "valid": body.valid,
        "reason": ", ".join(body.reasons),
        "inertia": inertia(body.values()),
        "covariance": body.covariance.ravel().tolist(),
    }


def inertia(values: FloatArray) -> dict[str, Any]:
    """Return mass, centre of mass and inertia (10,) as the values of geometry_msgs/msg/Inertia."""
    mass, x, y, z, *moments = values.tolist()
    named = {f"i{axes}": moment for axes, moment in zip(AXES, moments, strict=True)}
    return {"m": mass, "com": {"x": x, "y": y, "z": z}, **named}


def write_package(folder: Path) -> list[Path]:
    """Write the message package, which colcon builds, into a folder; return the paths.

    Raises
    ------
    ConfigError when a file cannot be written.
    """
    written = []
    try:
        for name, place in PACKAGE.items():
            path = folder / place / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes((files(__package__) / name).read_bytes())
            written.append(path)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
    return written
