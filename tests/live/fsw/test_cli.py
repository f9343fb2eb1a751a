"""The command line: exit codes, one clear message, and nothing opened on a wrong configuration."""

import json
import subprocess
import sys
from importlib.metadata import version

import pytest

from fsw.__main__ import main
from fsw.__main__ import main as fsw_main
from ground.__main__ import main as ground_main
from hil.__main__ import main as hil_main
from tests.conftest import ArmProject
from tests.support.commands import PROGRAMS

HEAVY = ("numpy", "scipy", "pinocchio", "mujoco", "rich", "pydantic")

# runs one command line and fails if anything that can open a device was even imported
NOTHING_OPENED = """
import sys
from fsw.__main__ import main
code = main(sys.argv[1:])
opened = {"can", "serial", "mcap"} & set(sys.modules)
sys.exit(f"imported {opened}" if opened else code)
"""


# runs one command on configuration after configuration and prints what became of each
EACH = """
import contextlib, io, json, sys
from fsw.__main__ import main
command, *paths = sys.argv[1:]
for path in paths:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([command, path])
    opened = sorted({"can", "serial", "mcap"} & set(sys.modules))
    print(json.dumps([code, out.getvalue(), err.getvalue(), opened]))
"""


def run_bare(*arguments):
    return subprocess.run(
        [sys.executable, "-c", NOTHING_OPENED, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_check_prints_what_the_daemon_would_do(arm, capsys):
    assert main(["check", str(arm.write())]) == 0
    out, err = capsys.readouterr()
    assert "3 joints" in out
    assert "config.yaml: valid, 2 warnings; no device was opened" in out
    assert "warning: imu.port: /dev/serial/imu does not exist now" in out
    assert err == ""


def test_check_imports_nothing_that_can_open_a_device(arm):
    done = run_bare("check", arm.write())
    assert (done.returncode, done.stderr) == (0, "")


def unknown_key(arm):
    arm.data["imu"]["colour"] = "red"
    return "imu.colour", "red", "allowed here"


def missing_robot(arm):
    arm.data["robot"]["urdf"] = "none.urdf"
    return "robot.urdf", "none.urdf", "No such file"


def wrong_joint_count(arm):
    arm.robot(4)
    return "joints", "axis3", "4 joints"


def negative_noise(arm):
    arm.data["joints"][0]["torque_noise_nm"] = -0.1
    return "joints.0.torque_noise_nm", "-0.1", "must be at least"


def shared_port(arm):
    arm.data["star_tracker"]["port"] = arm.data["imu"]["port"]
    return "star_tracker.port", "/dev/serial/imu", "one device only"


def unreadable_path(arm):
    (arm.folder / "file").touch()
    arm.data["recorder"]["directory"] = "file/below"
    return "recorder.directory", "file/below", "not a directory"


def short_lag(arm):
    arm.data["estimator"] = {"lag_s": 0.05}
    return "estimator.lag_s", "0.05", "at least 0.117"


SPOILERS = [
    unknown_key,
    missing_robot,
    wrong_joint_count,
    negative_noise,
    shared_port,
    unreadable_path,
    short_lag,
]


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_wrong_configuration_ends_with_exit_code_2_and_nothing_opened(tmp_path, command):
    """One interpreter runs the command on every spoilt configuration."""
    words, paths = {}, []
    for number, spoil in enumerate(SPOILERS):
        folder = tmp_path / str(number)  # short: a socket's path is at most 93 bytes long
        folder.mkdir()
        arm = ArmProject(folder)
        words[spoil.__name__] = spoil(arm)
        paths.append(str(arm.write()))
    done = subprocess.run(
        [sys.executable, "-c", EACH, command, *paths],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    results = dict(zip(words, map(json.loads, done.stdout.splitlines()), strict=True))
    for name, (code, out, err, opened) in results.items():
        assert (code, out, opened, len(err.splitlines())) == (2, "", [], 1), (name, err)
        assert [word for word in words[name] if word not in err] == [], (name, err)


def test_replay_checks_its_configuration_before_the_recording(arm):
    arm.data["robot"]["tool_frame"] = "hand"
    done = run_bare("replay", arm.folder / "none.mcap", "--config", arm.write())
    assert done.returncode == 2
    assert "robot.tool_frame: 'hand'" in done.stderr


def test_an_absent_configuration_is_exit_code_2(tmp_path, capsys):
    assert main(["run", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml: cannot be read" in capsys.readouterr().err


def test_without_a_command_the_usage_is_shown(capsys):
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == 2
    assert "usage: fsw" in capsys.readouterr().err


@pytest.mark.parametrize("pair", ["last_s", "last_s=soon"])
def test_a_wrong_command_argument_is_exit_code_2(arm, capsys, pair):
    assert main(["ctl", str(arm.write()), "run-batch", pair]) == 2
    assert "last_s" in capsys.readouterr().err


def test_what_fsw_run_imports_stays_light():
    program = (
        "import sys, fsw.checks.configuration, fsw.loop.app\n"
        "heavy = {'scipy.signal', 'scipy.optimize', 'scipy.stats', 'mujoco', 'rich'}\n"
        "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_what_flies_loads_neither_planner_nor_offline_tools(arm):
    """Of both only the parsers of the command line, its words and its progress."""
    program = f"""
import sys, fsw.__main__ as line, fsw.loop.app, fsw.estimation.process, fsw.service.process
from fsw.checks.configuration import validate_ports
arguments = line.parser().parse_args(["run", {str(arm.write())!r}])
validate_ports(line._checked(line._config(arguments)))
print(*(name for name in sys.modules if name.partition(".")[0] in ("planner", "offline")))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    arguments = {"offline.excite_arguments", "offline.init.arguments", "offline.out_argument"}
    words = {"offline", "offline.init", "offline.examples", "offline.progress"}
    assert set(done.stdout.split()) == arguments | words | {"offline.recording_arguments"}


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_command_line_is_read_without_what_its_commands_need(program):
    """Every process of a bench reads one: numpy, SciPy and MuJoCo alone take two seconds."""
    code = f"""
import sys
from {program}.__main__ import parser
parser()
print([name for name in {HEAVY} if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("entry", [fsw_main, hil_main, ground_main])
def test_every_command_says_its_version(entry, capsys):
    with pytest.raises(SystemExit) as caught:
        entry(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.split()[-1] == version("inertia-daemon")


def test_planning_without_its_libraries_is_one_line(arm, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "casadi", None)
    for name in [name for name in sys.modules if name.startswith("planner.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "offline.excite", raising=False)
    assert main(["excite", str(arm.write())]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install 'inertia-daemon[excite]'" in line
