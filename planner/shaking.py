"""The swing of panels and liquid under a motion: a mode's response to the base's acceleration.

A mode has inertia M about its axis u and, with the base held, natural frequency f [rad/s] and
damping ratio z. The motion of the base drives it (acceleration a of the base's origin, wd, w; c is
the mode's centre of mass from its place p, d = p + c, I its inertia about c):

    x'' + 2 z f x' + f^2 x = -Q / M,   Q = m l . (a + wd x d + w x (w x d)) + u . (I wd + w x I w)

with l = u x c for a panel, l = u for liquid (whose I is zero). The limit bounds
sqrt(x^2 + (x'/f)^2), and so also the swinging after the motion. Neglected are the reaction of the
mode on the base and the change of d by x.
"""

import numpy as np
from scipy.linalg import toeplitz
from scipy.signal import cont2discrete

from fsw.config import ModeConfig
from fsw.estimators.model.inertia import skew
from fsw.estimators.model.modes import modal_inertia
from fsw.messages import FloatArray


class Shaking:
    """Response of one axis of a mode on a grid of equal steps, from rest."""

    def __init__(self, mode: ModeConfig, axis: int, count: int, step_s: float) -> None:
        u, c = np.array(mode.axes_B[axis]), np.array(mode.com_m)
        xx, xy, xz, yy, yz, zz = mode.inertia_kg_m2 or (0.0,) * 6
        self._I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self._u, self._d = u, np.array(mode.p_B_m) + c
        self._l = mode.mass_kg * (np.cross(u, c) if mode.kind == "panel" else u)
        rate, damping = 2.0 * np.pi * mode.frequency_hz, mode.damping_ratio
        plant = (
            np.array([[0.0, rate], [-rate, -2.0 * damping * rate]]),  # of x and x'/f
            np.array([[0.0], [-1.0 / (rate * modal_inertia(mode))]]),
            np.eye(2),
            np.zeros((2, 1)),
        )
        A, B, C, D, _ = cont2discrete(plant, step_s, "foh")  # exact between linear samples
        pulse, state = [D[:, 0]], B[:, 0]
        for _ in range(count - 1):
            pulse.append(C @ state)
            state = A @ state
        columns = np.array(pulse).T
        self._response = np.stack([toeplitz(h, np.zeros(count)) for h in columns])  # (2, m, m)

    def swing(
        self,
        motion: tuple[FloatArray, FloatArray, FloatArray],
        by_z: tuple[FloatArray, FloatArray, FloatArray] | None,
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return x and x'/f (m, 2) [m or rad], and their derivatives (m, 2, v) if `by_z` is given.

        `motion`: a, wd and w of the base, (m, 3) each; `by_z`: their derivatives, (m, 3, v) each.
        """
        a, wd, w = motion
        u, d, by_wd = self._u, self._d, np.cross(self._d, self._l) + self._I @ self._u
        turned = np.cross(w, np.cross(w, d)) @ self._l + np.cross(w, w @ self._I) @ u
        force = a @ self._l + wd @ by_wd + turned
        x = np.einsum("kij,j->ik", self._response, force)
        if by_z is None:
            return x, None
        W = skew(w)
        by_w = -self._l @ (skew(np.cross(w, d)) + W @ skew(d)) + u @ (
            W @ self._I - skew(w @ self._I)
        )
        rows = np.einsum("i,kiv->kv", self._l, by_z[0]) + np.einsum("i,kiv->kv", by_wd, by_z[1])
        rows += np.einsum("ki,kiv->kv", by_w, by_z[2])
        return x, np.einsum("kij,jv->ikv", self._response, rows)
