"""The effects in the order in which they act; a new effect is registered here."""

from fsw.estimators.effects import thrusters, wheels
from fsw.estimators.effects.friction import COULOMB, LOAD, VISCOUS
from fsw.estimators.effects.motor_side import RIPPLE, ROTOR
from fsw.estimators.effects.thrusters import THRUSTERS, switched
from fsw.estimators.effects.wheels import WHEELS, carrier
from fsw.estimators.effects.wrench_sensor import WRENCH_SENSORS
from fsw.estimators.model import modes

TORQUE_EFFECTS = (VISCOUS, COULOMB, LOAD, ROTOR, RIPPLE)
ON_BASE = (wheels.ON_BASE, thrusters.ON_BASE, modes.ON_BASE)
DEVICES = (WHEELS, THRUSTERS, WRENCH_SENSORS)
__all__ = ["DEVICES", "ON_BASE", "TORQUE_EFFECTS", "carrier", "switched"]
