"""Robots with random damage: accepted, or refused in plain lines; never another exception."""

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.__main__ import main
from tests.conftest import arm_urdf

WORDS = (
    *("0", "-1", "1e-300", "1e300", "nan", "inf", "-inf", "", "0 0 0", "1 2", "x", "\u00e9\u2603"),
    *("link1", "link2", "axis1", "axis2", "bus", "gripper", "world", "universe", "root_joint"),
    *("planar", "floating", "continuous", "prismatic", "fixed", "revolute", "screw", "${x}"),
)
BLOCKS = (
    "<inertial>",
    "</inertial>",
    "<mass value=",
    "<limit ",
    "<axis ",
    "<origin ",
    "<parent ",
    "<child ",
    "<link name=",
    "<joint name=",
    "</joint>",
)
PIECES = (
    '<mimic joint="axis1"/>',
    '<link name="other"/>',
    "<xacro:macro/>",
    "<!-- -->",
    "<inertial/>",
    '<transmission name="t"><joint name="axis1"/></transmission>',
    '<gazebo reference="link1"/>',
    "\x00",
    "&amp;",
    "<",
)
ATTRIBUTES = tuple(arm_urdf(2).split('"')[1::2])
damage = st.one_of(
    st.tuples(st.just("value"), st.integers(0, len(ATTRIBUTES) - 1), st.sampled_from(WORDS)),
    st.tuples(st.just("cut"), st.sampled_from(BLOCKS), st.integers(0, 5)),
    st.tuples(st.just("insert"), st.sampled_from(PIECES), st.integers(0, 60)),
)


def damaged(text: str, wounds: list) -> str:
    for kind, first, second in wounds:
        if kind == "value":
            parts = text.split('"')
            parts[(2 * first + 1) % (len(parts) - 1 or 1)] = second
            text = '"'.join(parts)
        elif kind == "cut":
            parts = text.split(first)
            text = first.join(parts[: second + 1]) + first.join(["", *parts[second + 2 :]])
        else:
            parts = text.split("<")
            place = second % len(parts)
            text = "<".join(parts[:place]) + first + "<" + "<".join(parts[place:])
    return text


@settings(max_examples=60)
@given(st.lists(damage, min_size=1, max_size=3), st.sampled_from(["target", "base"]))
def test_a_damaged_robot_is_accepted_or_refused_in_words(wounds, unknown):
    with TemporaryDirectory() as folder:
        urdf, out = Path(folder) / "arm.urdf", Path(folder) / "robot.yaml"
        urdf.write_text(damaged(arm_urdf(2), wounds), encoding="utf-8")
        flags = f"--tool gripper --unknown {unknown} --target-mass-kg 5 --base free --tracker none"
        flags += " --imu stim300 --imu-xyz 0 0 0 --imu-rpy 0 0 0"
        error = io.StringIO()
        with redirect_stderr(error), redirect_stdout(io.StringIO()):
            code = main(["init", str(urdf), "--out", str(out), *flags.split()])
            assert code in (0, 2)
            if code == 0:
                assert main(["check", str(out)]) == 0, error.getvalue()
        lines = error.getvalue().splitlines()
        assert len(lines) == (code == 2), lines
        assert out.exists() == (code == 0)
