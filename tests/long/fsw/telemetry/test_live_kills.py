"""kill -9 of the whole daemon while it loads, activates and saves: the old or the new, no mixture.

What is kept on the disk is killed at every single file event in test_power_cut; here all of it,
in the running daemon: a table of the loop, one of the service, parameters and the state.
"""

import time
import zlib

from fsw.telemetry.link.packets import parameters_data
from tests.conftest import ArmProject, arm_urdf
from tests.support.live_daemon import Ground, running

RATES, NOISE, ROBOT = 3, 2, 1
BATCH_LAST_S, TIME_EXPONENT = 6, 5  # parameters
LOADED, DONE = "loaded", "done"  # killed before the activation, and after all is over
# where the daemon is killed: a step, or so long after the activation was sent [s]
KILLS = (LOADED, 0.0, 0.003, 0.012, 0.04, DONE)


def contents(k: int) -> dict[int, bytes]:
    """The tables of the k-th round; robot and noise take turns, they exclude each other."""
    mass = f'mass value="{4 + k}"'
    loop = (
        (NOISE, f"joints: {{axis2: {{torque_noise_nm: 0.{k + 1}}}}}".encode()),
        (ROBOT, arm_urdf(3).replace('mass value="3"', mass).encode()),
    )[k % 2]
    return {RATES: f"sets: {{7: {{interval_s: {k + 1}.0}}}}".encode(), loop[0]: loop[1]}


def parameters(k: int) -> dict[int, float]:
    return {BATCH_LAST_S: 10.0 + k, TIME_EXPONENT: float(1 + k)}


def stage(ground: Ground, table: int, content: bytes) -> None:
    size = {"table": table, "size_bytes": len(content), "crc32": zlib.crc32(content)}
    assert ground.tell("TBL_LOAD", size) == "completion_success"
    for offset in range(0, len(content), 900):
        piece = {"table": table, "offset": offset, "data": content[offset : offset + 900]}
        assert ground.tell("TBL_DATA", piece) == "completion_success"
    assert ground.tell("TBL_VALIDATE", {"table": table}) == "completion_success"


def change_all(ground: Ground, k: int) -> list[int]:
    """Send all that changes something at once."""
    sent = [
        ground.send("TBL_ACTIVATE", {"table": table, "crc32": zlib.crc32(content)})
        for table, content in contents(k).items()
    ]
    data = parameters_data(parameters(k))
    values = {"count": data[0], "parameter": int.from_bytes(data[1:3], "big"), "value": data[3:]}
    sent.append(ground.send("SET_PARAMETERS", values))
    sent.append(ground.send("SAVE_STATE"))
    return sent


def wait_for_all(ground: Ground, sent: list[int]) -> None:
    """Read until every telecommand is completed, in whatever order."""
    left = {0xC000 | sequence for sequence in sent}
    while left:
        left.discard(ground.wait("completion_success").values["request_sequence"])


def in_force(ground: Ground) -> tuple[dict[int, int], dict[int, float]]:
    """CRC of every active table, and the parameters."""
    ground.send("REPORT_SET", {"sid": 6})
    told = ground.wait("tables").values
    names = {RATES: "rates", NOISE: "noise", ROBOT: "robot"}
    assert all(told[f"{name}_state"] == 0 for name in names.values()), "nothing is half staged"
    tables = {number: told[f"{name}_active_crc32"] for number, name in names.items()}
    found = {}
    for number, name in ((BATCH_LAST_S, "batch_last_s"), (TIME_EXPONENT, "time_report_exponent")):
        ground.send("REPORT_PARAMETERS", {"count": 1, "parameter": number})
        found[number] = ground.wait(f"parameter_{name}").values[name]
    return tables, found


def test_a_daemon_killed_while_it_takes_tables_and_parameters_has_the_old_or_the_new(
    arm: ArmProject,
):
    with running(arm, start_mode="standby") as run:
        tables, values = {RATES: 0, NOISE: 0, ROBOT: 0}, {}
        for k, moment in enumerate(KILLS):
            ground = run.connect()
            ground.mode("STANDBY")
            before_tables, before_values = in_force(ground)
            if k:
                assert (before_tables, before_values) == (tables, values)
            for table, content in contents(k).items():
                stage(ground, table, content)
            sent = change_all(ground, k) if moment is not LOADED else []
            if moment is DONE:
                wait_for_all(ground, sent)
            elif moment is not LOADED:
                time.sleep(moment)
            run.kill()
            run.again()
            ground = run.connect()
            ground.mode("STANDBY")
            tables, values = in_force(ground)
            new = before_tables | {t: zlib.crc32(c) for t, c in contents(k).items()}
            for table, crc32 in tables.items():
                assert crc32 in (before_tables[table], new[table]), (moment, table)
            assert values in (before_values, parameters(k)), moment
            if moment is LOADED:
                assert (tables, values) == (before_tables, before_values)
            if moment is DONE:
                assert (tables, values) == (new, parameters(k))
            ground.link.close()
        log = (run.state / "events.jsonl").read_text()
        assert "CORRUPT" not in log
        assert run.end() == 0
