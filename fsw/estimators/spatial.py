"""Compiled spatial arithmetic: inertias, momenta, the factor of a free body.

Everything about the base's origin in its axes, linear part first; an inertia J (10,) is m, h,
Ixx Ixy Ixz Iyy Iyz Izz. Needs numba. Source: Featherstone, Rigid Body Dynamics Algorithms (2008),
ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

from fsw.messages import FloatArray

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile to machine code at the first call, cached on disk; releases the interpreter lock."""
    return _compile(function)


def routine(function: F) -> F:
    """Compile a function that makes no arrays: numba then leaves out the counting of references.

    Counting them at every call and slice takes as long as all the arithmetic of a pass.
    """
    return _compile(function, _nrt=False)


def inlined(function: F) -> F:
    """Compile as `routine` does, copied into the callers: passing many arrays costs more."""
    return _compile(function, _nrt=False, forceinline=True)


def _compile(function: F, **flags: bool) -> F:
    fastmath = {"contract", "reassoc", "nsz"}
    flags |= {"cache": True, "nogil": True}
    jit = numba.njit(error_model="numpy", fastmath=fastmath, **flags)  # type: ignore[call-overload]
    return cast(F, jit(function))


@inlined
def set_inertia(pi: FloatArray, J: FloatArray) -> None:
    """Set J (10,) to the parameters pi (10,) of a body whose frame is the base's."""
    J[0], J[1], J[2], J[3] = pi[0], pi[1], pi[2], pi[3]
    J[4], J[5], J[6] = pi[4], pi[5], pi[7]
    J[7], J[8], J[9] = pi[6], pi[8], pi[9]


@inlined
def place_inertia(
    b: FloatArray,
    r00: float, r01: float, r02: float,
    r10: float, r11: float, r12: float,
    r20: float, r21: float, r22: float,
    px: float, py: float, pz: float,
    J: FloatArray,
) -> None:  # fmt: skip
    """Set J (10,) to the parameters b (10,) of a body whose frame is turned by r and at p."""
    m = b[0]
    hx = r00 * b[1] + r01 * b[2] + r02 * b[3]
    hy = r10 * b[1] + r11 * b[2] + r12 * b[3]
    hz = r20 * b[1] + r21 * b[2] + r22 * b[3]
    # R I, then R I R^T
    a0 = r00 * b[4] + r01 * b[5] + r02 * b[7]
    a1 = r00 * b[5] + r01 * b[6] + r02 * b[8]
    a2 = r00 * b[7] + r01 * b[8] + r02 * b[9]
    b0 = r10 * b[4] + r11 * b[5] + r12 * b[7]
    b1 = r10 * b[5] + r11 * b[6] + r12 * b[8]
    b2 = r10 * b[7] + r11 * b[8] + r12 * b[9]
    c0 = r20 * b[4] + r21 * b[5] + r22 * b[7]
    c1 = r20 * b[5] + r21 * b[6] + r22 * b[8]
    c2 = r20 * b[7] + r21 * b[8] + r22 * b[9]
    both = 2.0 * (px * hx + py * hy + pz * hz) + m * (px * px + py * py + pz * pz)
    J[0], J[1], J[2], J[3] = m, hx + m * px, hy + m * py, hz + m * pz
    J[4] = a0 * r00 + a1 * r01 + a2 * r02 + both - 2.0 * px * hx - m * px * px
    J[5] = a0 * r10 + a1 * r11 + a2 * r12 - px * hy - py * hx - m * px * py
    J[6] = a0 * r20 + a1 * r21 + a2 * r22 - px * hz - pz * hx - m * px * pz
    J[7] = b0 * r10 + b1 * r11 + b2 * r12 + both - 2.0 * py * hy - m * py * py
    J[8] = b0 * r20 + b1 * r21 + b2 * r22 - py * hz - pz * hy - m * py * pz
    J[9] = c0 * r20 + c1 * r21 + c2 * r22 + both - 2.0 * pz * hz - m * pz * pz


@inlined
def momentum(J: FloatArray, V: FloatArray, out: FloatArray) -> None:
    """Set out (6,) = momentum of an inertia J (10,) at a velocity V (6,)."""
    m, hx, hy, hz = J[0], J[1], J[2], J[3]
    vx, vy, vz, wx, wy, wz = V[0], V[1], V[2], V[3], V[4], V[5]
    out[0] = m * vx + wy * hz - wz * hy
    out[1] = m * vy + wz * hx - wx * hz
    out[2] = m * vz + wx * hy - wy * hx
    out[3] = hy * vz - hz * vy + J[4] * wx + J[5] * wy + J[6] * wz
    out[4] = hz * vx - hx * vz + J[5] * wx + J[7] * wy + J[8] * wz
    out[5] = hx * vy - hy * vx + J[6] * wx + J[8] * wy + J[9] * wz


@inlined
def factor_base(J: FloatArray, f: FloatArray) -> None:
    """Set f (10,) = 1/m, centre of mass, inverse central inertia of J (10,): H_bb^-1 in parts."""
    m = J[0]
    cx, cy, cz = J[1] / m, J[2] / m, J[3] / m
    xx = J[4] - m * (cy * cy + cz * cz)
    yy = J[7] - m * (cx * cx + cz * cz)
    zz = J[9] - m * (cx * cx + cy * cy)
    xy, xz, yz = J[5] + m * cx * cy, J[6] + m * cx * cz, J[8] + m * cy * cz
    d0, d1, d2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    det = xx * d0 + xy * d1 + xz * d2
    f[0], f[1], f[2], f[3] = 1.0 / m, cx, cy, cz
    f[4], f[5], f[6] = d0 / det, d1 / det, d2 / det
    f[7], f[8] = (xx * zz - xz * xz) / det, (xy * xz - xx * yz) / det
    f[9] = (xx * yy - xy * xy) / det


@inlined
def dot6(a: FloatArray, b: FloatArray) -> float:
    """Return a . b of two (6,)."""
    product: float = (
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
    )
    return product
