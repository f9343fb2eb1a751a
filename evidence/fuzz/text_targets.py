"""Targets for text: lines of the control socket, and the configuration."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from evidence.fuzz.oracle import Target, require
from fsw.config import parse
from fsw.errors import CommandError, ConfigError
from fsw.messages.commands import JOBS, MAX_LINE_BYTES, parse_command

MAX_FAULT_LINES = 10_000


def command_target() -> Target:
    """Return the target of lines of the control socket."""

    def one(data: bytes) -> None:
        for line in data.split(b"\n"):
            try:
                command = parse_command(line, 5)
            except CommandError as error:
                require(str(error), "a refusal without words", line)
                continue
            require(len(line) <= MAX_LINE_BYTES, "too long a line", len(line))
            require(command.id == 5, "another id", line)
            if command.name not in JOBS and command.args:
                continue  # the command has its arguments in another form
            text = json.dumps({"command": str(command.name), **command.args}).encode()
            require(parse_command(text, 5) == command, "not the same again", line, command)

    return one


def plain(value: object) -> Any:  # noqa: ANN401 - any plain value
    """Return a model's values as YAML can write them: lists for tuples, text for paths."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        return value
    return [plain(item) for item in value]


def config_target() -> Target:
    """Return the target of the text of a configuration.

    An input is the text itself, or `+` and lines that are appended to a correct configuration.
    """
    correct = CORRECT

    def one(data: bytes) -> None:
        text = correct + data[1:] if data[:1] == b"+" else data
        try:
            config = parse(text, Path("/nowhere"), "fuzz")
        except ConfigError as error:
            lines = str(error).splitlines()
            require(0 < len(lines) < MAX_FAULT_LINES, "faults", len(lines))
            return
        values = config.model_dump()
        text = yaml.safe_dump(plain(config.model_dump(mode="json")), sort_keys=False).encode()
        require(
            parse(text, Path("/nowhere"), "fuzz").model_dump() == values,
            "another configuration when written and read again",
            text,
        )

    return one


CORRECT = b"""\
robot: {urdf: a.urdf, tool_frame: t}
unknown: [base]
bodies:
  base: {mass_kg: 8.0, com_m: [0.1, 0.0, 0.4], inertia_kg_m2: [6.0, 0.0, 0.0, 5.0, 0.0, 4.0],
    sigma: {mass_kg: 4.0, com_m: [0.2, 0.2, 0.2], inertia_kg_m2: [3.0, 1.0, 1.0, 3.0, 1.0, 3.0]}}
buses: [{name: arm, interface: virtual, channel: c, rate_hz: 250.0}]
joints: [{name: j, bus: arm, node_id: 17, torque_limit_nm: 50.0, speed_limit_rad_s: 0.5,
  torque_noise_nm: 0.05, torque_offset_sigma_nm: 0.1, position_noise_rad: 1.0e-5}]
imu: {port: p, rate_hz: 500.0, mounting: {p_BS_m: [0.2, 0.1, 0.0], q_BS_xyzw: [0.0, 0.0, 0.0, 1.0]},
  gyro_group_delay_s: 0.002, acc_group_delay_s: 0.006, angle_random_walk_rad_sqrt_s: 4.0e-5,
  velocity_random_walk_m_s_sqrt_s: 1.0e-3, gyro_bias_sigma_rad_s: 1.0e-5, acc_bias_sigma_m_s2: 0.01}
scheduler: {tick_rate_hz: 500.0}
service: {state_directory: s}
"""
