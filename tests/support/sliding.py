"""The paper's robot with a prismatic joint in the place of its fourth."""

from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.config.joints import linear
from tests.support.estimator_cases import URDF, make_config

JOINT = 3


def sliding_urdf(folder: Path) -> Path:
    """Write the robot's URDF; return its path."""
    old = '<joint name="joint4" type="revolute">'
    text = URDF.read_text()
    assert old in text
    path = folder / "sliding.urdf"
    path.write_text(text.replace(old, old.replace("revolute", "prismatic")))
    return path


def sliding_config(folder: Path, unknown: tuple[str, ...], **options: Any) -> Config:
    data = make_config(unknown, **options).model_dump()
    data["robot"]["urdf"] = str(sliding_urdf(folder))
    own = data["joints"][JOINT]
    data["joints"] = list(data["joints"])
    data["joints"][JOINT] = {linear(key): own[key] for key in own} | {"kind": "prismatic"}
    return Config.model_validate(data)
