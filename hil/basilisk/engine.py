"""A program that simulates a craft in Basilisk under given torques, for the second truth.

`python engine.py JOB.npz OUT.npz`, run by the Python of an environment that has `bsk` and nothing
of this project. `hil.basilisk.craft` writes the first file and reads the second. Torques are
constant over a step; the integrator is Runge-Kutta of order four. The motion is unstable, so
springs and dampers hold the arm to its plan; the written torque includes them.
Source: Basilisk (AVS Lab, University of Colorado; ISC), modules spacecraft,
spinningBodyNDOFStateEffector, reactionWheelStateEffector, linearSpringMassDamper, extForceTorque.
"""

import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import (
    extForceTorque,
    linearSpringMassDamper,
    reactionWheelStateEffector,
    spacecraft,
    spinningBodyNDOFStateEffector,
)
from numpy.typing import NDArray

Model = Any  # Basilisk has no types
FloatArray = NDArray[np.float64]


def column(values: Sequence[float] | FloatArray) -> list[list[float]]:
    """Return a vector as a column, which Basilisk expects as a list of lists."""
    return [[float(x)] for x in values]


class Craft:
    """A spacecraft and its effectors, kept here because Basilisk holds no reference to them."""

    def __init__(self, about: dict[str, Any]) -> None:
        self.craft = craft = spacecraft.Spacecraft()
        craft.ModelTag = "craft"
        hub = about["hub"]
        craft.hub.mHub = hub["mass_kg"]
        craft.hub.r_BcB_B = column(hub["com_m"])
        craft.hub.IHubPntBc_B = hub["inertia_kg_m2"]
        craft.hub.r_CN_NInit = column([0.0, 0.0, 0.0])
        craft.hub.v_CN_NInit = column([0.0, 0.0, 0.0])
        craft.hub.sigma_BNInit = column(about["sigma_BN"])
        craft.hub.omega_BN_BInit = column(about["w_NB_B_rad_s"])
        self.chains = [self._chain(k, links) for k, links in enumerate(about["chains"])]
        self.slides = [self._slide(k, slide) for k, slide in enumerate(about["slides"])]
        self.panels = [self._bodies(f"panel{k}", [p])[0] for k, p in enumerate(about["panels"])]
        self.wheels = self._wheels(about["wheels"]) if about["wheels"] else None
        self.force = extForceTorque.ExtForceTorque()
        self.force.ModelTag = "force"
        craft.addDynamicEffector(self.force)
        chains = [effector for effector, _, _ in self.chains]
        wheels = [] if self.wheels is None else [self.wheels[0]]
        self.models = [*chains, *self.slides, *self.panels, *wheels, self.force, craft]
        for model in self.models:
            model.SelfInit()
        for model in self.models:
            model.Reset(0)
        states = craft.dynManager.getStateObject
        names = ["hubPosition", "hubVelocity", "hubSigma", "hubOmega"]
        for chain in chains:
            names += [chain.getNameOfThetaState(), chain.getNameOfThetaDotState()]
        names += [s.nameOfRhoState for s in self.slides]
        names += [panel.getNameOfThetaState() for panel in self.panels]
        names += [wheel.nameOfReactionWheelOmegasState for wheel in wheels]
        self.states = [states(name) for name in names]

    def _chain(self, k: int, links: list[dict[str, Any]]) -> tuple[Model, Model, list[Model]]:
        effector, bodies = self._bodies(f"chain{k}", links)
        torque = messaging.ArrayMotorTorqueMsg()
        effector.motorTorqueInMsg.subscribeTo(torque)
        return effector, torque, bodies

    def _bodies(self, tag: str, links: list[dict[str, Any]]) -> tuple[Model, list[Model]]:
        effector = spinningBodyNDOFStateEffector.SpinningBodyNDOFStateEffector()
        effector.ModelTag = tag
        bodies = []
        for link in links:
            body = spinningBodyNDOFStateEffector.SpinningBody()
            body.setMass(link["mass_kg"])
            body.setR_ScS_S(column(link["com_m"]))
            body.setISPntSc_S(link["inertia_kg_m2"])
            body.setR_SP_P(column(link["p_PS_P_m"]))
            body.setDCM_S0P(np.array(link["R_PS"]).T.tolist())
            body.setSHat_S(column(link["axis"]))
            body.setK(link.get("stiffness", 0.0))
            body.setC(link.get("damping", 0.0))
            body.setThetaInit(link["q_rad"])
            body.setThetaDotInit(link["qd_rad_s"])
            effector.addSpinningBody(body)
            bodies.append(body)
        self.craft.addStateEffector(effector)
        return effector, bodies

    def _slide(self, k: int, slide: dict[str, Any]) -> Model:
        effector = linearSpringMassDamper.LinearSpringMassDamper()
        effector.ModelTag = f"slide{k}"
        effector.massInit = slide["mass_kg"]
        effector.r_PB_B = column(slide["place_m"])
        effector.pHat_B = column(slide["axis"])
        effector.k, effector.c = slide["stiffness"], slide["damping"]
        effector.rhoInit = effector.rhoDotInit = 0.0
        self.craft.addStateEffector(effector)
        return effector

    def _wheels(self, wheels: list[dict[str, Any]]) -> tuple[Model, Model]:
        effector = reactionWheelStateEffector.ReactionWheelStateEffector()
        effector.ModelTag = "wheels"
        for wheel in wheels:
            config = reactionWheelStateEffector.RWConfigPayload()
            config.gsHat_B, config.rWB_B = wheel["axis"], wheel["place_m"]
            config.Js, config.Omega = wheel["inertia_kg_m2"], wheel["speed_rad_s"]
            config.mass = wheel["mass_kg"]
            config.u_max = config.Omega_max = -1.0  # no limit: the torque is given
            config.RWModel = reactionWheelStateEffector.BalancedWheels
            effector.addReactionWheel(config)
        torque = messaging.ArrayMotorTorqueMsg()
        effector.rwMotorCmdInMsg.subscribeTo(torque)
        self.craft.addStateEffector(effector)
        return effector, torque

    def state(self) -> FloatArray:
        """Return p_N, v_N, sigma_BN, w_B, then q and qd of every chain, slides, panels, wheels."""
        return np.array([x for state in self.states for row in state.getState() for x in row])

    def joints(self) -> list[int]:
        """Return the indices of all joint angles in the state, then those of all joint rates."""
        angles: list[int] = []
        rates: list[int] = []
        first = 12
        for _, _, bodies in self.chains:
            angles += range(first, first + len(bodies))
            rates += range(first + len(bodies), first + 2 * len(bodies))
            first += 2 * len(bodies)
        return angles + rates

    def momentum(self) -> list[float]:
        """Return the angular momentum about the centre of mass in frame N [N m s]."""
        return [float(row[0]) for row in self.craft.totRotAngMomPntC_N]

    def step(
        self, end_ns: int, before_ns: int, tau: FloatArray, motor: FloatArray, wrench: FloatArray
    ) -> None:
        """Advance to `end_ns` under joint and motor torques [N m] and the hub's wrench in B."""
        first = 0
        for _, message, bodies in self.chains:
            _write(message, tau[first : first + len(bodies)])
            first += len(bodies)
        if self.wheels is not None:
            _write(self.wheels[1], motor)
        self.force.extForce_B, self.force.extTorquePntB_B = column(wrench[:3]), column(wrench[3:])
        for model in self.models[:-1]:
            model.UpdateState(before_ns)
        self.craft.UpdateState(end_ns)


def _write(message: Model, torque: FloatArray) -> None:
    payload = messaging.ArrayMotorTorqueMsgPayload()
    payload.motorTorque = torque.tolist()
    message.write(payload, 0)


def main(job: str, out: str) -> None:
    """Simulate the job of one file; write states, momenta and torques of all steps to another."""
    with np.load(job) as given:
        about = json.loads(str(given["about"]))
        tau, motor, wrench = given["tau_nm"], given["motor_nm"], given["wrench"]
        hold = given["hold"]
        wanted = np.hstack([given["q_rad"], given["qd_rad_s"]])
    craft, step_ns = Craft(about), round(about["dt_s"] * 1e9)
    craft.craft.UpdateState(0)
    places = craft.joints()
    last = len(hold) - 1
    states, momenta, held = [craft.state()], [craft.momentum()], []
    for k in range(len(tau)):
        gains = hold[min(k // about["hold_steps"], last)]
        held.append(tau[k] + gains @ (wanted[k] - states[-1][places]))
        craft.step((k + 1) * step_ns, k * step_ns, held[-1], motor[k], wrench[k])
        states.append(craft.state())
        momenta.append(craft.momentum())
    np.savez(out, state=states, momentum_nms=momenta, tau_nm=held)


if __name__ == "__main__":
    main(*sys.argv[1:])
