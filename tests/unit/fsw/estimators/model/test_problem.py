"""The state's layout, its prior, and where it goes in the parameters of the robot."""

import numpy as np
import pinocchio as pin
import pytest

from fsw.config import BodyConfig, Config
from fsw.errors import ConfigError
from fsw.estimators.model.building import body_prior, build_problem, joint_order
from fsw.estimators.model.inertia import from_parameters
from fsw.estimators.model.state_groups import BY_NAME
from tests.support.estimator_cases import (
    BASE,
    TARGET,
    make_config,
    make_problem,
    parameters,
    plain,
    robot_model,
)


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("target", "base")])
def test_state_at_the_truth_gives_the_whole_robot(unknown: tuple[str, ...]) -> None:
    problem = make_problem(unknown)
    model = robot_model()
    expected = model.total_parameters(parameters(BASE), parameters(TARGET))
    np.testing.assert_allclose(problem.pi(problem.prior_mean), expected, rtol=1e-13, atol=1e-12)
    assert problem.unknown == tuple(sorted(unknown))  # base before target


def test_known_target_and_unknown_base_stay_apart() -> None:
    problem = make_problem(("base",))
    step = np.zeros(len(problem.names))
    step[problem.body("base")] = 1.0
    change = problem.pi(problem.prior_mean + step) - problem.pi(problem.prior_mean)
    np.testing.assert_allclose(change[:10], 1.0)
    np.testing.assert_allclose(change[10:], 0.0)


def test_names_follow_the_slices() -> None:
    problem = make_problem(("base", "target"), momentum_sigma_nms=1.0)
    assert len(problem.names) == len(problem.prior_mean) == 20 + 7 + 3 + 3 + 3
    assert problem.names[:2] == ("base.m", "base.mcx")
    assert problem.names[problem.body("target")][0] == "target.m"
    assert problem.names[problem.at("torque_offset")][6] == "torque_offset.joint7"
    for kind in ("acc_bias", "gyro_bias", "momentum"):
        assert problem.names[problem.at(kind)] == tuple(f"{kind}.{axis}" for axis in "xyz")


def test_a_nuisance_without_uncertainty_is_no_state() -> None:
    problem = make_problem(("target",), biases=False)
    assert len(problem.names) == 10
    for kind in ("torque_offset", "acc_bias", "gyro_bias", "momentum"):
        assert len(problem.prior_mean[problem.at(kind)]) == 0
        assert not problem.has(kind)


def test_a_group_is_part_of_the_state_if_it_has_a_state() -> None:
    problem = make_problem(("target",), momentum_sigma_nms=1.0)
    kinds = {name.partition(".")[0] for name in problem.names}
    assert "momentum" in kinds
    assert {name for name in BY_NAME if problem.has(name)} == kinds & set(BY_NAME)
    with pytest.raises(KeyError):
        problem.has("momentums")


def test_prior_spreads_as_configured() -> None:
    """Small sigmas: the map is linear there; 4e4 draws fix a deviation to 0.4 %, allowed 3 %."""
    mean, covariance = body_prior(BodyConfig.model_validate(plain(TARGET, 0.001)))
    np.testing.assert_allclose(mean, parameters(TARGET), rtol=1e-14)
    rng = np.random.default_rng(0)
    small = plain(TARGET, 0.001)
    small["sigma"]["com_m"] = [1e-4] * 3
    small["sigma"]["inertia_kg_m2"] = [0.05] * 6
    mean, covariance = body_prior(BodyConfig.model_validate(small))
    draws = mean + rng.normal(size=(40_000, 10)) @ np.linalg.cholesky(covariance).T
    report = np.array([np.hstack(from_parameters(pi)) for pi in draws])
    expected = [0.4, *[1e-4] * 3, *[0.05] * 6]
    np.testing.assert_allclose(report.std(axis=0), expected, rtol=0.03)


def test_a_body_without_sigma_has_no_spread() -> None:
    config = plain(TARGET)
    del config["sigma"]
    assert not body_prior(BodyConfig.model_validate(config))[1].any()


def test_joints_of_other_names_are_refused() -> None:
    config = make_config()
    joints = (config.joints[0].model_copy(update={"name": "elbow"}), *config.joints[1:])
    with pytest.raises(ConfigError, match="elbow"):
        joint_order(config.model_copy(update={"joints": joints}), robot_model())


def test_offsets_follow_the_models_order_of_joints() -> None:
    config = make_config()
    joints = list(config.joints)
    joints[0] = joints[0].model_copy(update={"torque_offset_sigma_nm": 0.7})
    shuffled = config.model_copy(update={"joints": tuple(joints[::-1])})
    problem = build_problem(shuffled, robot_model())
    sigma = np.sqrt(np.diag(problem.prior_covariance))[problem.at("torque_offset")]
    np.testing.assert_allclose(sigma, [0.7] + [0.2] * 6)


def test_the_urdfs_base_is_used_where_none_is_configured() -> None:
    config = make_config()
    bodies = {"target": config.bodies["target"]}
    problem = build_problem(config.model_copy(update={"bodies": bodies}), robot_model())
    np.testing.assert_allclose(problem.pi_known[:10], robot_model().pi_links[:10])


def with_box(unknown: tuple[str, ...], frame: str, **changes: object) -> Config:
    """Return a configuration in which a link of the arm holds a box."""
    data = make_config(("base", "target")).model_dump()
    data["bodies"]["box"] = plain(TARGET) | {"frame": frame} | changes
    return Config.model_validate(data | {"unknown": unknown})


@pytest.mark.parametrize("unknown", [("target",), ("box", "base"), ("box", "target", "base")])
def test_a_body_in_a_frame_of_its_own_adds_to_the_link_that_holds_it(unknown) -> None:
    model = robot_model()
    problem = build_problem(with_box(unknown, "link4"), model, exact=True)
    expected = model.total_parameters(parameters(BASE), parameters(TARGET))
    frame = model.model.frames[model.model.getFrameId("link4")]
    box = frame.placement.act(pin.Inertia.FromDynamicParameters(parameters(TARGET)))
    expected[40:50] += box.toDynamicParameters()
    np.testing.assert_allclose(problem.pi(problem.prior_mean), expected, rtol=1e-12, atol=1e-10)
    places = {"base": 0, "target": 1, "box": 2}
    assert problem.unknown == tuple(sorted(unknown, key=places.__getitem__))


@pytest.mark.parametrize(
    ("unknown", "frame", "word"),
    [
        (("target", "box"), "tool", "'target' and 'box' are fixed to one another"),
        (("base", "box"), "base", "'base' and 'box' are fixed to one another"),
        (("target",), "claw", "bodies.box.frame: 'claw'"),
    ],
)
def test_a_body_that_cannot_be_told_from_another_is_refused(unknown, frame, word) -> None:
    with pytest.raises(ConfigError, match=word):
        build_problem(with_box(unknown, frame), robot_model())


def test_a_known_body_on_a_link_may_differ_from_its_data() -> None:
    data = with_box(("target",), "link4").model_dump()
    data["robot"]["links_sigma_ratio"] = 0.05
    data["bodies"]["box"]["sigma"] = None
    problem = build_problem(Config.model_validate(data), robot_model())
    ways = [name for name in problem.names if name.startswith("known.box.")]
    assert len(ways) == 10
