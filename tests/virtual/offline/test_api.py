"""The Python API on a flight in virtual time: the same figures as the commands."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fsw
from fsw.__main__ import main
from fsw.errors import ConfigError
from hil.run.bench import prepare
from tests.support.excitation_cases import LIMITS_FILE
from tests.support.sampled_cases import as_arrays, in_the_robots_axes, sampled, sampled_config
from tests.support.short_cases import short

ROOT = Path(__file__).parents[3]
HEAVY = ("numpy", "scipy", "pinocchio", "pydantic", "can", "mcap")


def test_the_package_itself_imports_nothing_heavy():
    """A process that only imports `fsw` pays nothing for the API."""
    code = f"import fsw, sys; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# numpy is there before the API, and no variable of the environment is set
BLAS_THREADS = """
import os
for name in [name for name in os.environ if name.endswith("_NUM_THREADS")]:
    del os.environ[name]
import numpy
from threadpoolctl import threadpool_info
from offline import api
from offline.threads import on_one_thread

def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

for name in ("check", "identify", "plan", "replay", "report"):
    assert hasattr(getattr(api, name), "__wrapped__")
print(threads(), on_one_thread(threads)(), threads())
"""
# the command line comes first
BLAS_OF_COMMANDS = """
import os, sys
os.environ.pop("OPENBLAS_NUM_THREADS", None)
from fsw.__main__ import main
assert "numpy" not in sys.modules
main(["check", "nothing.yaml"])
import numpy
from threadpoolctl import threadpool_info
print({pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})
"""


def test_blas_has_one_thread_while_the_api_works_and_then_as_many_as_before():
    done = subprocess.run(
        [sys.executable, "-c", BLAS_THREADS], capture_output=True, text=True, check=True
    )
    all_of_them = {len(os.sched_getaffinity(0))}
    assert done.stdout.strip() == f"{all_of_them} {{1}} {all_of_them}"


def test_the_command_line_sets_one_thread_before_numpy_loads():
    done = subprocess.run(
        [sys.executable, "-c", BLAS_OF_COMMANDS], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "{1}"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nothing"):
        _ = fsw.nothing  # type: ignore[attr-defined]
    assert all(callable(getattr(fsw, name)) for name in fsw.__all__)
    assert dir(fsw) == sorted(fsw.__all__)


def test_identify_gives_what_the_command_prints(flown, capsys):
    path, config = flown / "recording.mcap", flown / "flight.yaml"
    found = fsw.identify(path, fsw.Robot(config), method="mrnea")
    main(["identify", str(path), "--config", str(config), "--method", "mrnea", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert found.values["estimate"] == printed["estimate"]
    assert (found.valid, found.status) == (printed["status"] == "OK", printed["status"])
    p = len(found.names)
    assert (found.mean.shape, found.covariance.shape) == ((p,), (p, p))
    np.testing.assert_array_equal(found.mean, printed["mean"])
    target = found.bodies["target"]
    assert target.com_m.shape == (3,)
    assert target.inertia_kg_m2.shape == (6,)
    payload = json.loads(found.export("json"))
    assert payload["mass_kg"] == pytest.approx(found.values["estimate"]["target"]["mass_kg"])
    assert str(found).startswith("mrnea, unknown target")


def test_check_gives_what_the_command_prints(flown, capsys):
    path, config = flown / "recording.mcap", flown / "flight.yaml"
    assert main(["check", str(config), str(path)]) == 0
    assert f"{fsw.check(path, fsw.Robot(config))}\n" == capsys.readouterr().out


def test_the_recording_brings_its_own_robot(flown):
    recording = fsw.load(flown / "recording.mcap")
    assert "/serial/imu" in recording.channels
    assert not recording.truncated
    robot = recording.robot
    assert (len(robot.joints), robot.unknown) == (7, ("target",))
    online = fsw.replay(recording, to_s=3.0)
    same = fsw.replay(recording, fsw.Robot(flown / "flight.yaml"), to_s=3.0)
    assert online.estimate is not None
    assert same.estimate is not None
    np.testing.assert_array_equal(online.estimate.mean, same.estimate.mean)
    unpacked = robot.config.resolve(robot.config.robot.urdf)
    assert unpacked.exists()
    del robot, recording
    assert not unpacked.exists(), "left behind"


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"method": "best"}, "method: 'best' must be one of mrnea"),
        ({"weighting": "wls"}, "only mrnea has one"),
        ({"unknown": "arm"}, "bodies.arm: missing; unknown lists 'arm'"),
        ({"unknown": ","}, "unknown: ',' must name a body"),
        ({"unknown": "base"}, "sigma"),
    ],
)
def test_a_wrong_choice_is_one_line(flown, choices, words):
    robot = fsw.Robot(flown / "flight.yaml")
    with pytest.raises(ConfigError, match=re.escape(words)):
        fsw.identify(flown / "recording.mcap", robot, **choices)


def test_a_recording_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        fsw.load(tmp_path / "nowhere.mcap")


def test_a_plan_keeps_its_limits_and_is_written(flown, tmp_path):
    robot = fsw.Robot(flown / "flight.yaml")
    motion = fsw.plan(robot, LIMITS_FILE, duration_s=10.0, iterations=4)
    t_s, q, qd, qdd = motion.samples(10.0)
    assert len(motion.joints) == 7
    assert q.shape == qd.shape == qdd.shape == (len(t_s), 7)
    assert t_s[-1] == pytest.approx(10.0)
    assert all(use.excess <= 0 for use in motion.uses)
    assert 0 < motion.sigma["target.mass_kg"] < 293.1, "less than the prior's"
    motion.save(tmp_path / "plan.yaml")
    assert (tmp_path / "plan.csv").exists()


def test_the_page_of_the_api_does_what_it_says(flown, tmp_path, monkeypatch, capsys):
    """Every block of docs/api.md runs, in order, in one interpreter."""
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    assert len(blocks) >= 4
    for name in ("flight.yaml", "robot.urdf", "recording.mcap"):
        (tmp_path / name).symlink_to(flown / name)
    (tmp_path / "robot.yaml").symlink_to(flown / "flight.yaml")
    (tmp_path / "limits.yaml").symlink_to(LIMITS_FILE)
    (folder := tmp_path / "arrays").mkdir()
    setup = prepare(short(folder, hurry=2.0), 1, folder)
    config = sampled_config(setup)
    arrays = in_the_robots_axes(as_arrays(*sampled(setup, config, 1)), config)
    np.savez(tmp_path / "arm.npz", **arrays)
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/api.md", "exec"), space)
    assert "kg" in capsys.readouterr().out


def test_wrong_arguments_are_configuration_errors(flown, tmp_path):
    path = tmp_path / "recording.mcap"
    path.write_bytes(before := (flown / "recording.mcap").read_bytes())
    robot = fsw.Robot(flown / "flight.yaml")
    for wrong in (
        lambda: fsw.report(path, robot, path),
        lambda: fsw.identify(path, robot, report=path),
        lambda: fsw.identify(path, "flight.yaml"),
        lambda: fsw.identify(path, robot, unknown=["target"]),
        lambda: fsw.identify(path, robot, to_s="8"),
        lambda: fsw.plan(robot, "limits.yaml", duration_s=-1.0),
        lambda: fsw.plan(robot, "limits.yaml", iterations=0),
        lambda: fsw.plan(robot, "limits.yaml", seed=-1),
    ):
        with pytest.raises(ConfigError):
            wrong()
    assert path.read_bytes() == before
