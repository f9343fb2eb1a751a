"""What `fsw check` says an effect costs if it is left out, beside flights in which it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fsw.checks.configuration import validate
from fsw.config import Config
from fsw.estimators.model.building import build_problem
from fsw.messages import Block, FloatArray
from hil.run import bench
from hil.world.scenario import Scenario, changed, load
from planner import left_out, spline
from planner.effects import Cost, costs
from tests.support.short_cases import NoMeter, short

FACTOR = 3.0  # between the predicted cost and the error that is seen; stated before it was
SEEDS = (1, 2, 3, 4)


def declared(scenario: Scenario, folder: Path, key: str) -> tuple[bench.Setup, Cost]:
    setup = bench.prepare(scenario, SEEDS[0], folder)
    motion = spline.load(scenario.identification)
    found = costs(setup.config, validate(setup.config)[0], motion)
    return setup, next(cost for cost in found if key in cost.key)


def mass_error_kg(setup: bench.Setup, config: Config) -> float:
    """Return the error of the target's mass where a configuration's daemon flies."""
    recorded = bench.run_virtual(replace(setup, config=config), NoMeter(), record=False)
    last = recorded.estimates[-1]
    return float(last.mean[0] - setup.scenario.truth["target"][0])


def test_friction_that_no_state_knows_costs_as_much_as_is_foretold(tmp_path):
    scenario = changed(short(tmp_path, points=8), ["sensors.joints.friction_coulomb_sigma_nm=0.3"])
    cost = declared(scenario, tmp_path, "friction_coulomb")[1]
    assert cost.is_modelled
    errors = []
    for seed in SEEDS:
        setup = bench.prepare(scenario, seed, tmp_path)
        joints = [
            j.model_copy(update={"friction_coulomb_sigma_nm": 0.0}) for j in setup.config.joints
        ]
        without = setup.config.model_copy(update={"joints": tuple(joints)})
        errors.append(mass_error_kg(setup, without))
    seen_kg = float(np.sqrt(np.mean(np.square(errors))))
    assert cost.mass_kg[0] / FACTOR < seen_kg < cost.mass_kg[0] * FACTOR


def with_the_wheels_of(setup: bench.Setup, without: Config) -> float:
    """Return the error of the mass by the same rows, for the speeds that the wheels really had."""
    problem = validate(setup.config)[0]
    motion = spline.load(setup.scenario.identification)
    truth, inertias = setup.history, [wheel.inertia_kg_m2 for wheel in setup.config.wheels]

    def sampled(block: Block, rows: FloatArray) -> FloatArray:
        t_s = 1e-9 * block.t_ns
        return np.stack([np.interp(t_s, truth.t_s, own) for own in rows.T], axis=1) * inertias

    turning = [
        replace(
            block,
            carried_nms=sampled(block, truth.wheel_rad_s),
            carried_nm=sampled(block, truth.wheel_rad_s2),
        )
        for block in left_out.blocks_along(setup.config, problem, motion)
    ]
    state = problem.prior_mean.copy()  # at rest the wheels have all of the momentum
    state[problem.at("momentum")] = problem.carrier.axes @ (inertias * truth.wheel_rad_s[0])
    there = left_out.channels(turning, replace(problem, prior_mean=state))
    own = build_problem(without, problem.model)
    blocks = left_out.blocks_along(without, own, motion)
    information = left_out.Information(own, "fused", blocks)
    return float(information.shift(left_out.measured(blocks, there)).error[0])


def test_wheels_that_the_configuration_has_not_cost_as_much_as_is_foretold(tmp_path):
    setup, cost = declared(load("wheels_leo"), tmp_path, "wheels")
    without = setup.config.model_copy(update={"wheels": ()})
    seen_kg = mass_error_kg(setup, without)
    assert cost.mass_kg[0] / FACTOR < abs(seen_kg) < cost.mass_kg[0] * FACTOR
    assert 1.0 / FACTOR < with_the_wheels_of(setup, without) / seen_kg < FACTOR  # sign as well
