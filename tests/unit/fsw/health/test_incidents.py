"""One event when a fault begins, one when it is over, none for what another fault explains."""

from fsw.config import Config
from fsw.health import Health
from fsw.health.incidents import RECOVERED, Incidents
from fsw.messages.findings import HIGH, LOW, Fault, Finding, severity
from tests.support.driver_configs import unit_on_bus
from tests.support.wheel_cases import config_with_wheels

MS = 1_000_000
RECOVER_NS = 500 * MS
WINDOW_NS = 550 * MS


def incidents() -> Incidents:
    return Incidents(RECOVER_NS, {"j1": "arm", "j2": "arm"}, WINDOW_NS)


def take(tested: Incidents, t_ns: int, fault: Fault, subject: str) -> list[str]:
    event = tested.take(Finding(t_ns, fault, subject), t_ns)
    return [] if event is None else [event.code]


def test_a_fault_that_goes_on_is_one_incident_and_ends_after_the_recovery_time() -> None:
    tested = incidents()
    told = []
    for k in range(100):
        told += take(tested, 10 * MS * k, Fault.IMU_CRC, "imu")
        told += [e.code for e in tested.advance(10 * MS * k)]
    assert told == ["IMU_CRC"]
    last_ns = 990 * MS
    assert tested.advance(last_ns + RECOVER_NS - 1) == []
    (over,) = tested.advance(last_ns + RECOVER_NS)
    assert (over.code, over.severity) == (RECOVERED, "info")
    assert "IMU_CRC over after 0.99 s, 100 findings" in over.text
    assert tested.status()["incidents"] == {"IMU_CRC": 1}
    assert tested.status()["findings"] == {"IMU_CRC": 100}
    assert tested.status()["faulty"] == {}


def test_a_flickering_fault_is_one_incident() -> None:
    tested = incidents()
    told = []
    for k in range(20):
        told += take(tested, 400 * MS * k, Fault.GYRO_FAULT, "gyro")
        told += [e.code for e in tested.advance(400 * MS * k + 399 * MS)]
    assert told == ["GYRO_FAULT"]


def test_what_every_window_shows_is_one_incident_until_a_window_is_without_it() -> None:
    """Windows of 0.4 s, judged 0.15 s behind: between two findings is more than the recovery."""
    tested = incidents()
    told = []
    for k in range(5):
        known_ns = 400 * MS * k + 190 * MS
        event = tested.take(Finding(400 * MS * k, Fault.ACC_INCONSISTENT, "acc"), known_ns)
        told += [] if event is None else [event.code]
        told += [e.code for e in tested.advance(known_ns + 399 * MS)]
    assert told == ["ACC_INCONSISTENT"]
    assert tested.advance(1600 * MS + WINDOW_NS + RECOVER_NS - 1) == []
    assert [e.code for e in tested.advance(1600 * MS + WINDOW_NS + RECOVER_NS)] == [RECOVERED]


def test_two_subjects_are_two_incidents() -> None:
    tested = incidents()
    assert take(tested, 0, Fault.TORQUE_STUCK, "j1") == ["TORQUE_STUCK"]
    assert take(tested, 0, Fault.TORQUE_STUCK, "j2") == ["TORQUE_STUCK"]
    assert tested.status()["faulty"] == {"j1": ["TORQUE_STUCK"], "j2": ["TORQUE_STUCK"]}


def test_a_bus_explains_its_joints_and_consequences_keep_it_open() -> None:
    tested = incidents()
    assert take(tested, 0, Fault.BUS_OFF, "arm") == ["BUS_OFF"]
    for k in range(1, 10):
        assert take(tested, 300 * MS * k, Fault.JOINT_SILENT, "j1") == []
        assert tested.advance(300 * MS * k) == []
    assert tested.status()["incidents"] == {"BUS_OFF": 1}
    assert tested.status()["consequences"] == 9
    assert take(tested, 2700 * MS, Fault.IMU_CRC, "imu") == ["IMU_CRC"]


def test_a_bus_explains_all_its_devices_and_no_serial_line() -> None:
    data = config_with_wheels().model_dump(mode="json")
    unit_on_bus(data)
    health = Health(Config.model_validate(data))
    found = [
        Finding(0, Fault.BUS_OFF, "arm"),
        Finding(1, Fault.WHEEL_SILENT, "wheel1"),
        Finding(2, Fault.IMU_SILENT, "imu"),
        Finding(3, Fault.TRACKER_SILENT, "star_tracker"),
    ]
    health.take(found, 3)
    assert [event.code for event in health.events()] == ["BUS_OFF", "TRACKER_SILENT"]


def test_a_joint_explains_nothing_of_another() -> None:
    tested = incidents()
    take(tested, 0, Fault.JOINT_SILENT, "j1")
    assert take(tested, 0, Fault.JOINT_LOST, "j1") == []
    assert take(tested, 0, Fault.JOINT_LOST, "j2") == ["JOINT_LOST"]


def test_every_fault_has_one_severity() -> None:
    assert not HIGH & LOW
    assert {severity(fault) for fault in Fault} == {"high", "medium", "low"}


def test_a_stall_is_one_event_and_explains_what_it_delays() -> None:
    tested = incidents()
    stalled = tested.stalled(100 * MS, 183 * MS, 190 * MS)
    assert stalled is not None
    assert (stalled.code, stalled.severity) == ("LOOP_STALLED", "low")
    assert "83 ms" in stalled.text
    for t_ns in (100 * MS, 183 * MS, 283 * MS):
        assert take(tested, t_ns, Fault.IMU_JITTER, "imu") == []
        assert take(tested, t_ns, Fault.JOINT_LATE, "j1") == []
    assert tested.stalled(300 * MS, 310 * MS, 310 * MS) is None  # the same incident
    assert tested.advance(310 * MS + RECOVER_NS - 1) == []
    (over,) = tested.advance(310 * MS + RECOVER_NS)
    assert "LOOP_STALLED over" in over.text
    assert "2 findings, explains IMU_JITTER 3, JOINT_LATE 3" in over.text
    assert tested.status()["incidents"] == {"LOOP_STALLED": 1}
    assert tested.status()["consequences"] == 6


def test_a_stall_hides_no_fault_that_was_there_before_or_continues_behind_it() -> None:
    tested = incidents()
    assert take(tested, 90 * MS, Fault.IMU_SILENT, "imu") == ["IMU_SILENT"]
    tested.stalled(100 * MS, 150 * MS, 150 * MS)
    take(tested, 160 * MS, Fault.IMU_SILENT, "imu")  # belongs to the open incident
    assert tested.status()["findings"] == {"IMU_SILENT": 2, "LOOP_STALLED": 1}
    assert take(tested, 200 * MS, Fault.BUS_SILENT, "arm") == []
    assert take(tested, 251 * MS, Fault.BUS_SILENT, "arm") == ["BUS_SILENT"]


def test_a_stall_explains_no_value_of_a_sensor() -> None:
    for fault in Fault:
        tested = incidents()
        tested.stalled(100 * MS, 150 * MS, 150 * MS)
        told = take(tested, 160 * MS, fault, "imu")
        is_of_time = fault.endswith(("SILENT", "LOST", "LATE", "ORDER", "JITTER", "STALLED"))
        is_of_time |= fault is Fault.LOOP_OVER_BUDGET  # the work that has waited
        if fault is Fault.IMU_BYTES_LOST or not is_of_time:
            assert told == [str(fault)]
