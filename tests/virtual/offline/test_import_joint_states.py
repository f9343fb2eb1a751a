"""`fsw import` of JointState messages as real drivers publish them: no joint gets another's."""

import json
from collections.abc import Callable

import pytest

from fsw.exchange.recording import messages
from tests.support.import_cases import Import, importing  # noqa: F401
from tests.support.joint_bags import ROWS, State, changed, whole, write

MAPPING = {
    "joints": {
        "time": {"column": "/joint_states.stamp", "unit": "s"},
        "position": {"columns": "/joint_states.position.{}", "unit": "rad"},
        "torque": {"columns": "/joint_states.effort.{}", "unit": "N m"},
    }
}


@pytest.fixture
def arm(importing: Callable[..., Import]) -> Import:  # noqa: F811
    return importing(sampled=True)


def torques(arm: Import) -> list[dict[str, float]]:
    found = [json.loads(item.data) for item in messages(arm.out, ["/samples/joints"])]
    return [row.get("torque_nm", {}) for row in found]


def split() -> list[State]:
    """Two publishers on one topic, a part of the arm each."""
    rows = []
    for state in map(whole, range(ROWS)):
        for i, later_ns in ((0, 0), (1, 100_000)):
            part = {"names": [state.names[i]], "position": [state.position[i]]}
            part |= {"effort": [state.effort[i]]}
            rows.append(State(**(state.__dict__ | part)).later(later_ns))
    return rows


def gripper(_k: int, state: State) -> dict[str, object]:
    """The effort is shorter than the names: the gripper's two fingers have none."""
    names = ["grip_l", *state.names, "grip_r"]
    return {"names": names, "position": [0.0, *state.position, 0.0], "effort": [*state.effort, 0.0]}


REFUSED = {
    "split": (split, "no message of /joint_states holds all of j1 j2; j1 comes alone"),
    "zero stamps": (
        lambda: changed(lambda _k, _s: {"stamp_ns": 0}),
        "all stamps of /joint_states are 0; use /joint_states.received",
    ),
    "no effort": (
        lambda: changed(lambda _k, _s: {"effort": []}),
        "effort is empty in every message of /joint_states",
    ),
    "no position": (
        lambda: changed(lambda _k, _s: {"position": []}),
        "position is empty in every message of /joint_states",
    ),
    "short effort": (
        lambda: changed(gripper),
        "effort has 3 values for 4 names in every message of /joint_states",
    ),
    "no effort, or short": (
        lambda: changed(lambda k, s: gripper(k, s) | ({"effort": []} if k % 2 else {})),
        "effort is empty in 150 and has 3 values for 4 names in 150 messages of /joint_states",
    ),
    "a name twice": (
        lambda: changed(lambda _k, _s: {"names": ["j1", "j1"]}),
        "names a joint twice in every message of /joint_states",
    ),
    "one stamp": (
        lambda: changed(lambda _k, _s: {"stamp_ns": 1_760_000_000 * 10**9}),
        "all 300 stamps are 1760000000",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_has_the_right_words(arm, name):
    make, words = REFUSED[name]
    bag = write(arm.folder / "bag", make())
    assert arm.table(bag, MAPPING) == 2
    assert arm.is_refused(words)
    assert "did you mean" not in arm.refused[0]


def test_torques_of_messages_with_short_effort_are_counted_and_go_to_no_joint(arm):
    bag = write(
        arm.folder / "bag",
        changed(lambda k, s: gripper(k, s) if k % 10 == 0 else {"effort": s.effort}),
    )
    assert arm.table(bag, MAPPING) == 0
    assert "effort has 3 values for 4 names, not read: 30 messages" in arm.said
    found = torques(arm)
    assert sum(not row for row in found) == 30
    assert all(abs(row["j1"] - 0.5) < 0.2 and abs(row["j2"] - 5) < 0.2 for row in found if row)


def test_another_order_a_gripper_in_between_and_empty_efforts_now_and_then_are_read(arm):
    def mixed(k: int, state: State) -> dict[str, object]:
        if k % 3 == 1:
            both = (state.names, state.position, state.effort)
            return dict(zip(("names", "position", "effort"), (x[::-1] for x in both), strict=True))
        return {"effort": []} if k % 3 == 2 else {}

    states = []
    for k, state in enumerate(changed(mixed)):
        states.append(state)
        if k % 5 == 0:
            finger = {"names": ["grip"], "position": [0.01], "effort": [0.1]}
            states.append(State(**(state.__dict__ | finger)).later(1000))
    assert arm.table(write(arm.folder / "bag", states), MAPPING) == 0
    found = torques(arm)
    assert len(found) == ROWS
    assert sum(not row for row in found) == ROWS // 3
    assert all(abs(row["j2"] - 5) < 0.2 for row in found if row)


def test_some_messages_without_a_stamp_are_left_out_and_counted(arm):
    bag = write(arm.folder / "bag", changed(lambda k, _s: {"stamp_ns": 0} if k < 4 else {}))
    assert arm.table(bag, MAPPING) == 0
    assert "rows without a time, left out: 4" in arm.said
    assert len(torques(arm)) == ROWS - 4


def test_a_missing_joint_is_never_replaced_by_another_quantity(arm):
    bag = write(arm.folder / "bag", changed(lambda _k, _s: {"names": ["j1", "j3"]}))
    assert arm.table(bag, MAPPING) == 2
    assert arm.is_refused("no column '/joint_states.position.j2'")
    assert "did you mean '/joint_states.position.j" in arm.refused[0]


def test_stamps_of_another_topic_are_named_for_a_topic_of_ones_own(arm):
    mapping = json.loads(json.dumps(MAPPING).replace("/joint_states", "/arm/state"))
    bag = write(arm.folder / "bag", changed(lambda _k, _s: {"stamp_ns": 0}), "/arm/state")
    assert arm.table(bag, mapping) == 2
    assert arm.is_refused("use /arm/state.received")
    mapping["joints"]["time"]["column"] = "/arm/state.received"
    assert arm.table(bag, mapping) == 0
