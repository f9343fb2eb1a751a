"""The paper's robot with a control-moment gyro: a gimbal on the base, a wheel on the gimbal."""

from pathlib import Path

import numpy as np

from fsw.estimators.model.robot import RobotModel
from hil.world.spline import JointSpline
from tests.support.estimator_cases import URDF

AXIAL_KG_M2 = 0.05
GYRO_JOINTS = ("a_gimbal", "a_rotor")
SWING_RATE_RAD_S = 0.6
GYRO = """<joint name="a_gimbal" type="revolute"><parent link="{root}"/><child link="cage"/>
<origin xyz="0.2 -0.1 0.3"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="20" velocity="1"/></joint>
<link name="cage"><inertial><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="a_rotor" type="revolute"><parent link="cage"/><child link="rotor"/>
<axis xyz="0 0 1"/><limit lower="-1e6" upper="1e6" effort="5" velocity="400"/></joint>
<link name="rotor"><inertial><mass value="6"/>
<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="{axial}"/></inertial></link></robot>"""


def with_gyro(folder: Path) -> Path:
    text = URDF.read_text()
    root = RobotModel(URDF, "tool").model.frames[2].name
    assert f'<link name="{root}">' in text
    path = folder / "gyro.urdf"
    path.write_text(text.replace("</robot>", GYRO.format(root=root, axial=AXIAL_KG_M2)))
    return path


def with_run_up(
    arm: JointSpline, names: tuple[str, ...], spin_rad_s: float, swing_rad_s: float
) -> JointSpline:
    """Return the arm's motion of joint1 to joint7 with a wheel that runs up and a gimbal's swing.

    `names` : of all joints, in the order of the robot; both stand still where `spin_rad_s` is 0
    """
    knots = np.arange(len(arm.control_points_rad)) * arm.knot_spacing_s
    run = np.clip(knots, knots[3], knots[-4]) - knots[3]
    swing = swing_rad_s / SWING_RATE_RAD_S * (1.0 - np.cos(SWING_RATE_RAD_S * run))
    own = dict(zip(GYRO_JOINTS, (swing, spin_rad_s * run), strict=True))
    order = [f"joint{k + 1}" for k in range(7)]
    columns = [
        own[name] if name in own else arm.control_points_rad[:, order.index(name)] for name in names
    ]
    return JointSpline(arm.duration_s, np.stack(columns, axis=1))
