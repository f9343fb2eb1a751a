"""Base class of all sections of the configuration, and types of values with bounds."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

MAX_MASS_KG = 1e6  # of a body; a space station has half of this mass
MAX_LENGTH_M = 100.0  # from the origin of a body's frame
MAX_INERTIA_KG_M2 = 1e9
SMALLEST = 1e-12  # least 1 sigma of a noise: its square does not underflow
SLOWEST_HZ = 1.0  # least rate of the reports of an actuator of the base
UNIT_TOLERANCE = 1e-6  # of the length of a unit vector

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be 0")
    return value


Gain = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False), AfterValidator(_not_zero)]
# plausible values and sigmas of a space robot and its sensors
Mass = Annotated[float, Field(ge=1e-3, le=MAX_MASS_KG, allow_inf_nan=False)]
MassSigma = Annotated[float, Field(ge=1e-9, le=MAX_MASS_KG, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0, le=MAX_LENGTH_M, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH_M, le=MAX_LENGTH_M, allow_inf_nan=False)]
CoordinateSigma = Annotated[float, Field(ge=1e-9, le=MAX_LENGTH_M, allow_inf_nan=False)]
Inertia = Annotated[float, Field(ge=-MAX_INERTIA_KG_M2, le=MAX_INERTIA_KG_M2, allow_inf_nan=False)]
InertiaSigma = Annotated[float, Field(ge=1e-9, le=MAX_INERTIA_KG_M2, allow_inf_nan=False)]
TorqueNoise = Annotated[float, Field(ge=SMALLEST, le=1e4, allow_inf_nan=False)]
ForceNoise = Annotated[float, Field(ge=SMALLEST, le=1e4, allow_inf_nan=False)]
AngleNoise = Annotated[float, Field(ge=SMALLEST, le=1.0, allow_inf_nan=False)]
SpeedNoise = Annotated[float, Field(ge=SMALLEST, le=10.0, allow_inf_nan=False)]
RandomWalk = Annotated[float, Field(ge=SMALLEST, le=10.0, allow_inf_nan=False)]  # of rate, velocity
RotorSigma = Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)]  # 0: not estimated
Periods = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]  # in a turn
TorqueSigma = Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)]  # 0: not estimated
ForceSigma = Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)]
MomentumSigma = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Turn = Annotated[float, Field(ge=-6.3, le=6.3, allow_inf_nan=False)]  # rad: up to one revolution
AngleSigma = Annotated[float, Field(ge=0, le=1.0, allow_inf_nan=False)]  # 0: exact
ScaleSigma = Annotated[float, Field(ge=0, le=1.0, allow_inf_nan=False)]
SlowRate = Annotated[float, Field(ge=1e-4, le=1.0, allow_inf_nan=False)]  # rad/s
CorrelationTime = Annotated[float, Field(ge=1e-3, le=10.0, allow_inf_nan=False)]  # s
RateSigma = Annotated[float, Field(ge=0, le=1.0, allow_inf_nan=False)]
AccelerationSigma = Annotated[float, Field(ge=0, le=100.0, allow_inf_nan=False)]
Delay = Annotated[float, Field(ge=0, le=10.0, allow_inf_nan=False)]
DelayError = Annotated[float, Field(ge=-0.1, le=0.1, allow_inf_nan=False)]
DelaySigma = Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)]  # 0: exact
NodeId = Annotated[int, Field(ge=1, le=127)]  # of CANopen
Rate = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Interval = Annotated[float, Field(ge=0, le=1e7, allow_inf_nan=False)]  # s
Duration = Annotated[float, Field(gt=0, le=1e7, allow_inf_nan=False)]  # s
LongDuration = Annotated[float, Field(gt=0, le=1e30, allow_inf_nan=False)]  # s; may be endless

GravityComponent = Annotated[float, Field(ge=-30.0, le=30.0, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Matrix3 = tuple[Vector3, Vector3, Vector3]
PositiveVector3 = tuple[Positive, Positive, Positive]
Gravity = tuple[GravityComponent, GravityComponent, GravityComponent]
Position = tuple[Coordinate, Coordinate, Coordinate]
PositionSigma = tuple[CoordinateSigma, CoordinateSigma, CoordinateSigma]
InertiaVector = tuple[Inertia, Inertia, Inertia, Inertia, Inertia, Inertia]
InertiaSigmas = tuple[
    InertiaSigma, InertiaSigma, InertiaSigma, InertiaSigma, InertiaSigma, InertiaSigma
]
Quaternion = tuple[Finite, Finite, Finite, Finite]
BodyName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class Section(BaseModel):
    """Base class of every section: it refuses unknown keys and is immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def null_is_left_out(model: type[BaseModel], data: object) -> object:
    """Return data without those keys that are null and not required."""
    if not isinstance(data, dict):
        return data
    fields = model.model_fields
    return {
        key: value
        for key, value in data.items()
        if value is not None or key not in fields or fields[key].is_required()
    }


def allow_null(schema: dict[str, Any]) -> None:
    """Change a JSON schema so that every key that is not required may be null."""
    for key, value in schema["properties"].items():
        if key not in schema["required"] and "anyOf" not in value:
            inner = {name: value.pop(name) for name in list(value) if name != "default"}
            value["anyOf"] = [inner, {"type": "null"}]
