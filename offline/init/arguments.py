"""Arguments of `fsw init`."""

import argparse
from pathlib import Path

from offline.out_argument import out_argument

FIRST_NODE = 0x11


def node_number(text: str) -> int:
    """Return the integer that `text` states in decimal or with the prefix 0x."""
    return int(text, 0)


def rate(text: str) -> float:
    """Return the rate [Hz] in a text. Raises ValueError or, out of range, ArgumentTypeError."""
    value = float(text)
    if not 0.1 <= value <= 1e4:
        raise argparse.ArgumentTypeError(f"{text}: must be 0.1 to 10000 Hz")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `fsw init`; on a terminal the command asks for missing ones."""
    parser.add_argument("urdf", type=Path, metavar="URDF")
    out_argument(parser, "YAML", "robot.yaml")
    parser.set_defaults(out=Path("robot.yaml"), new=())  # `init list` writes nothing
    parser.add_argument("--tool", metavar="FRAME", help="link that grasps, fixed to the last one")
    parser.add_argument("--unknown", choices=("base", "target", "both"))
    parser.add_argument(
        "--base",
        choices=("free", "planar", "clamped"),
        help="what holds the base: nothing, a level table, a bench",
    )
    parser.add_argument("--target-mass-kg", type=float, metavar="M", help="half of it may be wrong")
    parser.add_argument("--imu", metavar="NAME", help="stim300, 3dm_cv7 ... or none; `init list`")
    parser.add_argument("--imu-xyz", type=float, nargs=3, metavar="M", help="its place in the base")
    parser.add_argument(
        "--imu-rpy", type=float, nargs=3, metavar="RAD", help="roll, pitch, yaw, as in a URDF"
    )
    parser.add_argument("--tracker", metavar="NAME", help="sagitta or none")
    parser.add_argument("--tracker-rpy", type=float, nargs=3, metavar="RAD")
    parser.add_argument("--encoder", default="generic_24_bit", metavar="NAME")
    parser.add_argument(
        "--torque",
        metavar="NAME",
        help="motor_current: from currents; else arm_sensor if clamped, generic if not",
    )
    wires = parser.add_mutually_exclusive_group()
    wires.add_argument(
        "--bus", metavar="NAME=DBC", help="joints described by a DBC, KCD, SYM or ARXML file"
    )
    wires.add_argument(
        "--eds",
        type=Path,
        nargs="+",
        metavar="EDS",
        help="joints described by EDS or DCF: one for all, or one each; or a bus.yml",
    )
    wires.add_argument("--feed", action="store_true", help="another program sends the joints")
    parser.add_argument(
        "--first-node",
        type=node_number,
        default=FIRST_NODE,
        metavar="ID",
        help="node of the first joint, the others follow; 0x11",
    )
    parser.add_argument("--rate-hz", type=rate, help="of the joints; 250, or the recording's")
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="FILE",
        help="CSV, .npz, bag or CAN log: rates, columns, messages, limits, noise",
    )
