"""Configurations of one's own for `target_leo` whose joints have no tailored node."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from hil.world.scenario import FOLDER
from tests.support.keys import write_key
from tests.support.short_cases import IMU_RATE_HZ

OWN = FOLDER / "configurations" / "target_leo.yaml"
COUNTS_PER_REV = 2**22
RATED_NM = 20.0
EDS = """[FileInfo]
FileName=drive.eds
[DeviceInfo]
[MandatoryObjects]
SupportedObjects=0
[OptionalObjects]
SupportedObjects=5
1=0x1800
2=0x1A00
3=0x6041
4=0x6064
5=0x6077
[1800]
ParameterName=TPDO1
ObjectType=0x9
SubNumber=3
[1800sub0]
ParameterName=last
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=2
[1800sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
[1800sub2]
ParameterName=type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00]
ParameterName=mapping
ObjectType=0x9
SubNumber=4
[1A00sub0]
ParameterName=count
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=3
[1A00sub1]
ParameterName=first
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60410010
[1A00sub2]
ParameterName=second
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60640020
[1A00sub3]
ParameterName=third
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x60770010
[6041]
ParameterName=statusword
ObjectType=0x7
DataType=0x0006
AccessType=ro
PDOMapping=1
[6064]
ParameterName=position
ObjectType=0x7
DataType=0x0004
AccessType=ro
PDOMapping=1
[6077]
ParameterName=torque
ObjectType=0x7
DataType=0x0003
AccessType=ro
PDOMapping=1
"""


def _dbc(folder: Path, joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe two frames of each drive in a DBC file; of every second drive, pages of one."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: drives"]
    for k, joint in enumerate(joints):
        is_one = bool(k % 2)
        angle, load = f"{joint['name']}_angle", f"{joint['name']}_{'angle' if is_one else 'load'}"
        page = ' SG_ page M : 60|4@1+ (1,0) [0|0] "" drives'
        own = [f"BO_ {0x202 + 16 * k} {load}: 8 drives"] * (not is_one)
        lines += [
            f"BO_ {0x201 + 16 * k} {angle}: 8 drives",
            f' SG_ angle {"m1 " * is_one}: 7|32@0- (0.00001,0) [0|0] "deg" drives',
            ' SG_ state : 32|8@1+ (1,0) [0|0] "" drives',
            *own,
            page,
            ' SG_ load m3 : 11|20@1- (0.5,-3) [0|0] "mN m" drives',
        ]
        joint |= {
            "signals": {
                "position": {"message": angle, "signal": "angle"},
                "torque": {"message": load, "signal": "load"},
                "status": {"message": angle, "signal": "state", "mask": 6, "value": 4},
            },
            "timing": {"by": "arrival", "sigma_s": 5.0e-6, "delay_s": 2.0e-5},
        }
    (folder / "robot.dbc").write_text("\n".join(lines) + "\n", encoding="cp1252")
    return {"sync": "none", "listen_only": True, "description": "robot.dbc"}


def _keys(_folder: Path, joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe one CAN FD frame of two drives each, with the time of the drive's clock."""
    messages = []
    for k, joint in enumerate(joints):
        place, message = k % 2, f"pair{k // 2}"
        fields = [
            {"name": f"q{place}", "start": 64 * place, "bits": 32, "number": "float"},
            {"name": f"tau{place}", "start": 64 * place + 32, "bits": 32, "number": "float"},
        ]
        if place:
            messages[-1]["signals"] += fields
        else:
            clock = {"name": "clock", "start": 128, "bits": 20, "unit": "us"}
            identifier = {"id": 0x18FF0000 + k, "extended": True}
            signals = [clock, *fields]
            messages.append({"name": message, **identifier, "length": 20, "signals": signals})
        joint |= {
            "signals": {
                "position": {"message": message, "signal": f"q{place}", "unit": "rev"},
                "torque": {"message": message, "signal": f"tau{place}", "unit": "N m"},
                "time": {"message": message, "signal": "clock"},
            },
            "timing": {"by": "device_time", "sigma_s": 5.0e-6, "delay_s": 3.0e-5},
        }
    return {"sync": "none", "listen_only": True, "fd": True, "messages": messages}


def _asked(_folder: Path, joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe motors that answer another master, in fields of 24, 12 and 20 bits."""
    messages = []
    for k, joint in enumerate(joints):
        fields = [
            {"name": "q", "start": 7, "bits": 24, "order": "big", "range": [-4.0, 4.0]},
            {"name": "qd", "start": 31, "bits": 12, "order": "big", "range": [-8.0, 8.0]},
            {"name": "tau", "start": 35, "bits": 20, "order": "big", "range": [-60.0, 60.0]},
        ]
        message = {"name": f"motor{k}", "id": 0x100 + k, "length": 7, "signals": fields}
        messages.append(message)
        joint |= {
            "signals": {
                "position": {"message": f"motor{k}", "signal": "q", "unit": "rad"},
                "torque": {"message": f"motor{k}", "signal": "tau", "unit": "N m"},
            },
            "timing": {"by": "request", "requests": [0x1F00 + k], "sigma_s": 5.0e-6},
        }
    return {"sync": "none", "listen_only": True, "latch_offset_s": 4e-5, "messages": messages}


def _eds(folder: Path, joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe CiA 402 nodes, whose PDO is of transmission type 1, in an EDS file."""
    (folder / "drive.eds").write_text(EDS, encoding="utf-8")
    for k, joint in enumerate(joints):
        counts = {"unit": "counts", "counts_per_rev": COUNTS_PER_REV}
        torque = {"unit": "permille", "rated_torque_nm": RATED_NM}
        joint |= {
            "node_id": 0x21 + k,
            "description": "drive.eds",
            "signals": {
                "position": {"message": "TPDO1", "signal": "0x6064"} | counts,
                "torque": {"message": "TPDO1", "signal": "0x6077"} | torque,
                "status": {"message": "TPDO1", "signal": "0x6041", "mask": 0x6F, "value": 0x27},
            },
            "timing": {"by": "last_sync"},
        }
    return {"sync_counter_max": 0}


def _feed(folder: Path, joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe a sender of datagrams with a clock and a key of its own, in another order."""
    joints.reverse()
    write_key(folder / "feed.key", bytes(range(32)))
    feed = {"source": 12, "clock": "unix", "key_file": "feed.key"}
    return {"interface": "samples", "channel": "feed.sock", "feed": feed}


WIRES: dict[str, Callable[[Path, list[dict[str, Any]]], dict[str, Any]]] = {
    "dbc": _dbc,
    "keys": _keys,
    "asked": _asked,
    "eds": _eds,
    "feed": _feed,
}


def own_wires(folder: Path, kind: str, rate_hz: float) -> Path:
    """Write a configuration of a kind of wires, with signs and zeros of its own; return its path.

    The arm is exact, so that a short motion judges the wires.
    """
    document = yaml.safe_load(OWN.read_text(encoding="utf-8"))
    document["robot"]["urdf"] = str((OWN.parent / document["robot"]["urdf"]).resolve())
    document["scheduler"]["tick_rate_hz"] = rate_hz
    document["imu"]["rate_hz"] = IMU_RATE_HZ
    driver = "samples" if kind == "feed" else "described"
    joints = [{**joint, "driver": driver, "bus": "left"} for joint in document["joints"]]
    for k, joint in enumerate(joints):
        del joint["node_id"]
        joint |= {"sign": (-1) ** k, "zero_offset_rad": 0.1 * k, "torque_gain": 1.0 + 0.02 * k}
        joint["position_noise_rad"] = max(2e-6, 0.6 * math.tau / COUNTS_PER_REV * (kind == "eds"))
    bus = {"name": "left", "interface": "socketcan", "channel": "can0", "rate_hz": rate_hz}
    document["buses"] = [bus | WIRES[kind](folder, joints)]
    document["joints"] = joints
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path
