"""A wrist's table, imported and identified: truth by MuJoCo; sensors that are declared wrong."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from evidence.imported.case import WRIST_OFFSET, Case, identified, imported, row_of
from offline.importing.bags import WRENCH, bag_columns

CHI2_4_9999 = 23.5
SEED = 40


def test_a_wrist_beside_the_joints_makes_the_mass_better_known(tmp_path: Path) -> None:
    rows = {}
    for sensors in ("joints", "both"):
        folder = tmp_path / sensors
        folder.mkdir()
        found = identified(Case("moving", sensors, SEED), folder)
        rows[sensors] = row_of(found)
        assert found["reasons"] == []
        assert rows[sensors]["nees"] < CHI2_4_9999
    assert rows["both"]["mass_sigma_kg"] < rows["joints"]["mass_sigma_kg"]
    offsets = [k for k, name in enumerate(found["names"]) if name.startswith("wrench_offset")]
    sigma = np.sqrt(np.diag(found["covariance"]))[offsets]
    assert np.all(sigma < 0.5 * np.repeat(WRIST_OFFSET, 3))
    assert [own["channel"] for own in found["wrench_noise"]] == [
        f"wrist.{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")
    ]


def test_the_wrist_alone_weighs_the_box_in_static_poses(tmp_path: Path) -> None:
    """The joints measure no torque. Poses show no inertia, so that the whole is not valid."""
    found = identified(Case("poses", "wrist", SEED), tmp_path)
    row = row_of(found)
    assert row["nees"] < CHI2_4_9999
    assert row["mass_sigma_kg"] < 0.1
    assert found["reasons"] == ["INSUFFICIENT_EXCITATION"]


@pytest.mark.parametrize(
    "changes",
    [
        (("sign", -1),),
        (("rpy_FS_rad", [0.0, 0.0, 0.7]),),
        (("rpy_FS_rad", [0.2, 0.0, 0.4]),),
        (("p_FS_m", [0.06, -0.02, 0.03]),),
    ],
    ids=["sign", "turned about its axis", "tilted", "displaced"],
)
def test_a_wrongly_declared_wrist_is_not_believed(tmp_path: Path, changes: Any) -> None:
    found = identified(Case("moving", "both", SEED, changes), tmp_path)
    assert "MODEL_MISMATCH" in found["reasons"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ((("sign", -1),), "wrench_sensors.0.sign (wrist): -1 should be 1"),
        ((("rpy_FS_rad", [np.pi, 0.0, 0.4]),), "set it to [0, 0, 0.4]"),
    ],
    ids=["sign", "turned by half"],
)
def test_check_names_a_wrong_sign_and_exchanged_axes(
    tmp_path: Path, changes: Any, words: str
) -> None:
    paths = imported(Case("moving", "both", SEED, changes), tmp_path)
    command = [sys.executable, "-m", "fsw", "check", *paths]
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    assert words in said.stdout


def test_a_bag_of_wrenches_has_their_columns(tmp_path: Path) -> None:
    store = get_typestore(Stores.LATEST)
    kinds, wrench = store.types, np.arange(6.0)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as out:
        connection = out.add_connection("/ft", WRENCH, typestore=store)
        for k in range(3):
            vectors = [
                kinds["geometry_msgs/msg/Vector3"](*(wrench[part] + k).tolist())
                for part in (slice(0, 3), slice(3, 6))
            ]
            stamp = kinds["builtin_interfaces/msg/Time"](sec=7 + k, nanosec=5)
            message = kinds[WRENCH](
                header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="wrist"),
                wrench=kinds["geometry_msgs/msg/Wrench"](*vectors),
            )
            out.write(connection, (7 + k) * 10**9, store.serialize_cdr(message, WRENCH))
    found = bag_columns(tmp_path / "bag").values
    names = [f"/ft.{part}.{axis}" for part in ("force", "torque") for axis in "xyz"]
    expected = wrench[None] + np.arange(3.0)[:, None]
    np.testing.assert_array_equal(np.column_stack([found[name] for name in names]), expected)
    np.testing.assert_allclose(found["/ft.stamp"], [7.000000005, 8.000000005, 9.000000005])
