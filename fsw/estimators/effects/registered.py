"""The effects in the order in which they act; a new effect is registered here."""

from fsw.estimators.effects.friction import COULOMB, LOAD, VISCOUS
from fsw.estimators.effects.motor_side import RIPPLE, ROTOR

TORQUE_EFFECTS = (VISCOUS, COULOMB, LOAD, ROTOR, RIPPLE)
