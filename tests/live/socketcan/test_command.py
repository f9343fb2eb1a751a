"""`hil run --bus socketcan` as one types it below `hil vcan --`."""

import json
import subprocess
import sys

import yaml

from hil.world.scenario import FOLDER
from tests.support.short_cases import short


def scenario_file(folder):
    """Write a short motion at 100 Hz as a scenario of its own."""
    made = short(folder, points=2, rate_hz=100.0, hurry=2)
    document = yaml.safe_load((FOLDER / "target_leo.yaml").read_text(encoding="utf-8"))
    document |= {
        "robot": {"urdf": str(made.urdf), "tool_frame": made.tool_frame},
        "bodies_file": str((FOLDER / document["bodies_file"]).resolve()),
        "trajectories": {
            "identification": str(made.identification),
            "verification": str(made.verification),
        },
        "timing": {"before_s": made.before_s, "after_s": made.after_s},
        "sensors": made.sensors,
        "flight": made.flight,
    }
    path = folder / "short_motion.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def test_a_scenario_runs_over_vcan0_from_the_command_line(tmp_path):
    command = [sys.executable, "-m", "hil", "run", str(scenario_file(tmp_path)), "--json"]
    command += ["--bus", "socketcan", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode in (0, 1), done.stderr  # so short a motion need not end valid
    outcome = json.loads(done.stdout)
    flight = yaml.safe_load((tmp_path / "out" / "flight.yaml").read_text(encoding="utf-8"))
    (bus,) = flight["buses"]
    assert (bus["interface"], bus["channel"]) == ("socketcan", "vcan0")
    assert outcome["simulated_s"] > 4.0
    samples = outcome["samples"]["arm"]
    assert samples["received"] > 7 * 100.0 * 4.0
    assert samples["rejected"] == 0
    assert outcome["daemon_exit_code"] == 0
