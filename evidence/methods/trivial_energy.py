"""CE as printed has a trivial solution, and the work-energy balance does not: the evidence.

The paper's CE (eqs. 32-34) minimises the squares of T - T_msr, T = 1/2 mu^T H mu with the measured
mu = [v_b, w_b, qd]. The paper does not define T_msr. If the energy at rest is conserved, T_msr is
zero. But T is linear in the parameters and positive for every physical body. So for any data the
cost is least at pi = 0, where the unknown bodies have no energy. The work of the motors is missing:
with T_msr = integral(tau^T qd dt) the cost is least at the truth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson

from evidence.methods.cases import RATE_HZ, scenario_of, truth_of
from evidence.methods.exact import base_velocity, exact_samples
from hil.judge.floating import FloatingRobot
from hil.world.inertia import COUNT, FloatArray, pi_of

STRIDE = 10
SCALES = (2.0, 1.0, 0.5, 0.1, 0.01, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrivialEnergy:
    """CE as printed and as work-energy balance, on the exact samples of a case; energies in J."""

    case: str
    scales: tuple[float, ...]  # factors on the true unknown parameters
    printed_rms_j: tuple[float, ...]  # root mean square of T - 0, by factor
    balance_rms_j: tuple[float, ...]  # root mean square of T - work, by factor
    printed_least: FloatArray  # (p,) unconstrained least squares of CE as printed
    balance_least: FloatArray  # (p,) unconstrained least squares of the balance
    truth: FloatArray  # (p,)
    unknown: tuple[str, ...]


def trivial_energy(case: str) -> TrivialEnergy:
    """Return both forms of CE along the exact motion, without noise and at the true mu."""
    scenario = scenario_of(case)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    state = exact_samples(case)
    mu = np.concatenate((base_velocity(state), state.w_NB_B, state.qd), axis=1)
    power = np.einsum("ij,ij->i", state.tau, state.qd)
    work = cumulative_simpson(power, dx=1.0 / RATE_HZ, initial=0)[::STRIDE]
    rows = 0.5 * np.array(
        [m @ robot.regressor(q, np.zeros(m.size), m) for q, m in zip(state.q, mu, strict=True)][
            ::STRIDE
        ]
    )
    known, own = rows @ robot.known, rows @ robot.select
    truth = truth_of(case)
    scale = np.sqrt(np.mean(own**2, axis=0))

    def least(energy: FloatArray) -> FloatArray:
        solution: FloatArray = np.linalg.lstsq(own / scale, energy - known, rcond=None)[0] / scale
        return solution

    def rms(energy: FloatArray) -> tuple[float, ...]:
        residuals = (known + s * (own @ truth) - energy for s in SCALES)
        return tuple(float(np.sqrt(np.mean(r**2))) for r in residuals)

    return TrivialEnergy(
        case=case,
        scales=SCALES,
        printed_rms_j=rms(np.zeros_like(work)),
        balance_rms_j=rms(work),
        printed_least=least(np.zeros_like(work)),
        balance_least=least(work),
        truth=truth,
        unknown=scenario.unknown,
    )


def sentences(found: TrivialEnergy) -> list[str]:
    """Return the finding as lines of text with figures."""
    lines = [
        f"CE as printed, total energy zero; unknown: {found.case}. Root mean square of the residual"
        " at the true parameters times a factor:"
    ]
    for s, printed, balance in zip(
        found.scales, found.printed_rms_j, found.balance_rms_j, strict=True
    ):
        lines.append(f"  x {s:<5g} T - 0: {printed:.3e} J    T - motors' work: {balance:.3e} J")
    for index, body in enumerate(found.unknown):
        k = COUNT * index
        lines.append(
            f"  {body} mass by least squares: {found.printed_least[k]:.3g} kg as printed, "
            f"{found.balance_least[k]:.6g} kg by the balance, {found.truth[k]:.6g} kg in truth"
        )
    lines.append(
        "  Every physical body adds positive energy, so the printed cost falls with the factor and "
        "is least without the body: the trivial solution. The balance is least at the truth."
    )
    return lines
