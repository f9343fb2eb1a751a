"""The simulated thruster node: the ICD's vector, its rate, its states, and what the valves do."""

import numpy as np
import pytest

from hil.devices.canopen import Reading
from hil.devices.thruster import ThrusterNode, encode_tpdo1
from hil.world.thrusters import Jet, Pulse, ThrusterSystem

NO_READING = Reading(0, 0, 0, 0, False)
JETS = (
    Jet(place_m=(0.0, 1.0, 0.0), direction=(2, 0, 0), force_n=10.0),
    Jet(place_m=(0.0, 0.0, 0.5), direction=(0, 0, 1), force_n=20.0),
)
SYSTEM = ThrusterSystem(
    jets=JETS,
    pulses=(Pulse(jet=0, on_s=1.0, for_s=0.5), Pulse(jet=1, on_s=2.0, for_s=1.0, reported=False)),
    delay_s=0.1,
    rise_s=0.2,
)


def test_vector_of_the_icd() -> None:
    data = encode_tpdo1([True, False, True], 0.01234, 7, 0x08, 42)
    assert data == bytes.fromhex("0500d2040700082a")
    assert encode_tpdo1([False], None, 256, 0x08, 1) == bytes.fromhex("0000ffff00000801")
    assert encode_tpdo1([True], 5.0, 1, 0x08, 1)[2:4] == b"\xff\xff"


def test_every_tenth_sync_is_answered_and_a_dead_node_says_nothing() -> None:
    own = ThrusterNode(node_id=0x31, joint=8, syncs_per_report=10, look=lambda: ([True], 0.001, 1))
    answers = [own.on_sync(k % 240 + 1, NO_READING, 0) for k in range(1000)]
    assert [k for k, pdos in enumerate(answers) if pdos] == list(range(9, 1000, 10))
    own.silent = True
    assert not any(own.on_sync(1, NO_READING, 0) for _ in range(20))


def test_the_node_knows_of_reported_firings_alone() -> None:
    assert SYSTEM.valves_at(0.9) == ([False, False], None, 0)
    assert SYSTEM.valves_at(1.2) == ([True, False], pytest.approx(0.2), 1)
    assert SYSTEM.valves_at(2.5) == ([False, False], pytest.approx(1.0), 2)


def test_force_follows_its_valve_late_and_slowly() -> None:
    np.testing.assert_array_equal(SYSTEM.wrench(1.099), np.zeros(6))
    share = 1.0 - np.exp(-1.0)
    risen = SYSTEM.wrench(1.3)
    np.testing.assert_allclose(risen, share * np.array([10.0, 0, 0, 0, 0, -10.0]), rtol=1e-12)
    np.testing.assert_allclose(SYSTEM.wrench(10.0), 0.0, atol=1e-9)
    times = np.arange(0.0, 10.0, 1e-3)
    impulse = sum(SYSTEM.wrench(t) for t in times) * 1e-3
    np.testing.assert_allclose(impulse, [5.0, 0, 20.0, 0, 0, -5.0], rtol=1e-3, atol=1e-12)
