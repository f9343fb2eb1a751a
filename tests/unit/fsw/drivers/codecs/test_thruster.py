"""Thruster nodes: the ICD's vector, and the DBC and EDS shipped agree with the codec."""

from pathlib import Path

import canopen as canopen_library
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw import drivers
from fsw.drivers.codecs import thruster

FOLDER = Path(drivers.__file__).parent
DATABASE = cantools.database.load_file(FOLDER / "ecss_thruster.dbc")
BITS = {"valves_valid": 3, "driver_fault": 4, "sync_lost": 6, "test_data": 7}
frames = st.binary(min_size=8, max_size=8)


def decoded(data: bytes) -> thruster.ThrusterTpdo1:
    return thruster.decode_tpdo1(np.frombuffer(data, np.uint8)[None])


def test_vector_of_the_icd() -> None:
    pdo = decoded(bytes.fromhex("0500d2040700082a"))
    assert (pdo.valves.tolist(), pdo.age_ns.tolist()) == ([5], [12_340_000])
    assert (pdo.changes.tolist(), pdo.status.tolist(), pdo.sync_counter.tolist()) == (
        [7],
        [8],
        [42],
    )
    assert thruster.valves_usable(pdo.status).all()
    assert decoded(bytes.fromhex("0500ffff0700082a")).age_ns.tolist() == [-1]


@given(frames)
def test_dbc_reads_the_pdo_as_the_codec_does(data: bytes) -> None:
    pdo, oracle = decoded(data), DATABASE.decode_message("TPDO1", data)
    assert pdo.valves.tolist() == [oracle["valves"]]
    assert pdo.changes.tolist() == [oracle["changes"]]
    assert pdo.sync_counter.tolist() == [oracle["sync_counter"]]
    if pdo.age_ns[0] >= 0:
        assert pdo.age_ns[0] * 1e-9 == pytest.approx(oracle["age"])
    bits = sum(oracle[name] << bit for name, bit in BITS.items())
    assert (int(pdo.status[0]) & thruster.STATUS_OF_VALVES) == bits


@settings(max_examples=50)
@given(frames)
def test_eds_maps_the_pdo_as_the_codec_reads_it(data: bytes) -> None:
    node = canopen_library.Network().add_node(0x31, str(FOLDER / "ecss_thruster.eds"))
    pdo = node.tpdo[1]
    pdo.read(from_od=True)
    assert pdo.cob_id == 0x1B1
    pdo.data = bytearray(data)
    valves, age, changes, _, status, counter = (variable.raw for variable in pdo)
    own = decoded(data)
    found = [own.valves, own.changes, own.status, own.sync_counter]
    assert [int(value[0]) for value in found] == [valves, changes, status, counter]
    assert age == thruster.OLD or own.age_ns[0] == age * thruster.AGE_SCALE_NS
