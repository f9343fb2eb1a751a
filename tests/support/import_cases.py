"""A clamped arm of two joints, and logs of it as other tools write them, for `fsw import`."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from fsw.__main__ import main
from fsw.exchange.recording import messages
from tests.support.sampled_cases import faults

CAN_HZ, SAMPLES_HZ = 250.0, 30.0
START_S = 1_760_000_010.0
NODES = (0x11, 0x12)
LINK = (
    '<inertial><mass value="2"/><origin xyz="0 0 0.1"/><inertia ixx="0.01" ixy="0" ixz="0" '
    'iyy="0.01" iyz="0" izz="0.01"/></inertial>'
)


def urdf(kinds: tuple[str, str] = ("revolute", "revolute")) -> str:
    """Return an arm of two joints about z and y (or along them) and a tool frame."""
    joints = "".join(
        f'<link name="{child}">{LINK}</link><joint name="{name}" type="{kind}">'
        f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.2"/>'
        f'<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="50" velocity="1"/></joint>'
        for name, kind, parent, child, axis in (
            ("j1", kinds[0], "base", "l1", "0 0 1"),
            ("j2", kinds[1], "l1", "l2", "0 1 0"),
        )
    )
    tool = (
        '<link name="tool0"/><joint name="tip" type="fixed"><parent link="l2"/>'
        '<child link="tool0"/><origin xyz="0 0 0.2"/></joint>'
    )
    return f'<robot name="arm"><link name="base">{LINK}</link>{joints}{tool}</robot>'


def joint(name: str, node: int, kind: str) -> dict[str, Any]:
    """Return the section of a joint, with the keys of its kind."""
    angle, force = ("rad", "torque") if kind == "revolute" else ("m", "force")
    unit = "nm" if kind == "revolute" else "n"
    return {
        "name": name,
        "bus": "arm",
        "node_id": node,
        "kind": kind,
        f"{force}_limit_{unit}": 50,
        f"speed_limit_{angle}_s": 1,
        f"{force}_noise_{unit}": 0.025,
        f"{force}_offset_sigma_{unit}": 0.1,
        f"{force}_scale_sigma_ratio": 0.005,
        f"position_noise_{angle}": 1e-5,
    }


def robot(
    folder: Path, *, sampled: bool = False, kinds: tuple[str, str] = ("revolute", "revolute")
) -> Path:
    """Write the arm's URDF and its configuration, for a CAN bus or for samples; return the path."""
    (folder / "arm.urdf").write_text(urdf(kinds))
    rate_hz = SAMPLES_HZ if sampled else CAN_HZ
    bus = {"name": "arm", "rate_hz": rate_hz} | ({"interface": "samples"} if sampled else {})
    prior = {"mass_kg": 2, "com_m": [0, 0, 0.1], "inertia_kg_m2": [0.02, 0, 0, 0.02, 0, 0.02]}
    sigma = {"mass_kg": 1, "com_m": [0.1, 0.1, 0.1], "inertia_kg_m2": [0.01] * 6}
    data = {
        "robot": {"urdf": "arm.urdf", "tool_frame": "tool0"},
        "unknown": ["target"],
        "bodies": {"target": prior | {"sigma": sigma}},
        "buses": [bus],
        "joints": [
            joint(name, node, kind)
            for name, node, kind in zip(("j1", "j2"), NODES, kinds, strict=True)
        ],
        "scheduler": {"tick_rate_hz": rate_hz},
        "recorder": {"directory": "recordings"},
        "service": {"state_directory": "state"},
        "base": {"motion": "clamped", "gravity_B_m_s2": [0.0, 0.0, -9.80665]},
        "estimator": {"window_s": 0.8 if sampled else 0.1},
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def frames(count: int = 200, start_s: float = START_S) -> Iterator[can.Message]:
    """Yield SYNC and two TPDOs of two nodes, `count` times at the declared rate."""
    for k in range(count):
        counter = bytes([k % 240 + 1])
        places = [(0.0, 0x80, counter)]
        for i, node in enumerate(NODES):
            at_s = 4e-4 * (i + 1)
            value = (1000 * k).to_bytes(4, "little") + bytes(3) + counter
            places += [(at_s, 0x180 + node, value), (at_s + 2e-4, 0x280 + node, bytes(8))]
        for later_s, word, data in places:
            yield can.Message(
                timestamp=round(start_s + k / CAN_HZ + later_s, 6),
                arbitration_id=word,
                is_extended_id=False,
                data=data,
                channel=0,
            )


def write_log(path: Path, start_s: float = START_S, count: int = 200) -> Path:
    """Write the frames as python-can's own writer of this kind of file does."""
    with can.Logger(path) as log:
        for message in frames(count, start_s):
            log.on_message_received(message)
    return path


def stamps_ns(path: Path, topic: str = "/can/arm") -> list[int]:
    """Return the stamps of a channel of a recording."""
    return [item.t_ns for item in messages(path, [topic])]


class Import:
    """`fsw import` in one folder: returns its exit code and keeps what it wrote."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._capsys = folder, capsys
        self.out = folder / "out.mcap"
        self.said = ""  # lines of stdout
        self.refused: list[str] = []  # lines of stderr that are no progress

    def __call__(self, *arguments: str) -> int:
        self._capsys.readouterr()
        files = ("--config", str(self.folder / "robot.yaml"), "--out", str(self.out))
        code = main(["import", *arguments, *files])
        written = self._capsys.readouterr()
        self.said, self.refused = written.out, faults(written.err)
        return code

    def can(self, path: Path, *more: str) -> int:
        """Import a log of the arm's bus."""
        return self(*("--can", f"arm={path}"), *more)

    def table(self, path: Path, mapping: object, *more: str) -> int:
        """Import a table with a mapping."""
        place = self.folder / "map.yaml"
        place.write_text(yaml.safe_dump(mapping))
        return self(str(path), "--map", str(place), *more)

    def is_refused(self, *words: str) -> bool:
        """Return whether one line has been said, with these words, and nothing was written."""
        return (
            (self.said, len(self.refused)) == ("", 1)
            and all(word in self.refused[0] for word in words)
            and not list(self.folder.glob("out*"))
        )


@pytest.fixture
def importing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Import]:
    """Return a function that writes the arm's configuration and returns `Import` beside it."""

    def prepare(**changes: Any) -> Import:
        robot(tmp_path, **changes)
        return Import(tmp_path, capsys)

    return prepare
