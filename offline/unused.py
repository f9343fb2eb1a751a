"""Sensors of a configuration of which nothing is used, as warnings of every command.

The estimator does without an inertial unit or a star tracker: it leaves their rows out, and sigma
says what that costs. A sensor is *needed* where the configuration asks for something that only this
sensor shows; a command that misses a needed sensor fails.
"""

from collections.abc import Mapping
from typing import Any

from fsw.config import Config
from fsw.exchange.sinks import IMU, STAR_TRACKER

BY_ATTITUDE = (  # of `estimator`: quantities in inertial axes
    "momentum_sigma_nms",
    "external_force_sigma_n",
    "external_torque_sigma_nm",
)


def needs(config: Config, method: str) -> dict[str, str]:
    """Return by source the reason why estimation by `method` cannot do without it."""
    found = {}
    if method == "cm":
        found[IMU] = "estimator.method cm"
    elif not config.joints:
        found[IMU] = "a body without joints"
    inertial = [f"estimator.{key}" for key in BY_ATTITUDE if getattr(config.estimator, key)]
    inertial += ["orbit"] if config.orbit is not None else []
    inertial += ["estimator.outside_wrench"] * (config.estimator.outside_wrench == "watch")
    if inertial:
        found[STAR_TRACKER] = inertial[0]
    return found


def unused_sensors(status: Mapping[str, Any]) -> dict[str, str]:
    """Return by source, in words, why nothing of a sensor can be used, or not all.

    `status` is that of a replay or of the daemon.
    """
    found = {}
    lacks: Mapping[str, str] = status.get("lacks", {})
    for source, counts in status["samples"].items():
        words = [lacks[source]] if source in lacks else []
        received = f"{counts['received']} samples, {counts['received_bytes']} bytes received"
        if not counts["accepted"]:
            words = [f"nothing usable; {received}", *words]
        elif counts["late"] >= counts["accepted"]:
            words = [f"nothing usable; all of {received} came too late for their windows", *words]
        if words:
            found[source] = "; ".join(words)
    return found


def unused_lines(status: Mapping[str, Any]) -> list[str]:
    """Return a line for each sensor of `unused_sensors`."""
    return [f"{source}: {words}" for source, words in unused_sensors(status).items()]


def missed(status: Mapping[str, Any], config: Config, method: str) -> list[str]:
    """Return a line for each needed sensor of which nothing can be used."""
    unused = unused_sensors(status)
    return [
        f"{source}: {unused[source]}; {reason} needs it"
        for source, reason in needs(config, method).items()
        if source in unused
    ]
