"""What `fsw check` says of effects that a configuration leaves out."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin

from fsw.checks.configuration import validate
from fsw.commands.describe import LOW_ORBIT_RAD_S, describe
from tests.support.excitation_cases import subject


def test_an_orbit_that_is_not_told_has_its_cost() -> None:
    config = subject("base").config
    problem, _ = validate(config)
    found = re.search(r"in low orbit up to (\S+) N m", describe(config, problem))
    assert found is not None
    model = pin.buildModelFromUrdf(
        str(config.resolve(config.robot.urdf)), pin.JointModelFreeFlyer()
    )
    base = config.bodies["base"]
    xx, xy, xz, yy, yz, zz = base.inertia_kg_m2
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    model.inertias[1] = pin.Inertia(base.mass_kg, np.array(base.com_m), inertia)
    data = model.createData()
    pin.ccrba(model, data, pin.neutral(model), np.zeros(model.nv))
    moments = np.linalg.eigvalsh(data.Ig.inertia)
    expected = 1.5 * LOW_ORBIT_RAD_S**2 * (moments[-1] - moments[0])
    np.testing.assert_allclose(float(found.group(1)), expected, rtol=0.05)
