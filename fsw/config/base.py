"""What every section of the configuration shares: strictness, and types with bounds."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
PositiveVector3 = tuple[Positive, Positive, Positive]
Vector6 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
PositiveVector6 = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Quaternion = tuple[Finite, Finite, Finite, Finite]
BodyName = Literal["base", "target"]


class Section(BaseModel):
    """Strictness shared by every section: no unknown keys, nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)
