"""Configurations whose unknown bodies start 30-50 % off, by case."""

from __future__ import annotations

from typing import Any

import numpy as np

from fsw.config import Config
from tests.fsw.estimators.cases import BASE, TARGET, make_config, wrong

CASES = {
    "base": ("base", ("base",)),
    "target": ("target", ("target",)),
    "both": ("target", ("base", "target")),
}


def config_of(case: str, seed: int, **options: Any) -> Config:
    """Return a configuration whose unknown bodies start 30-50 % off."""
    kind, unknown = CASES[case]
    rng = np.random.default_rng(1000 + seed)
    base = wrong(BASE, rng) if "base" in unknown else BASE
    target = wrong(TARGET, rng) if "target" in unknown else TARGET
    return make_config(unknown, base=base, target=target if kind == "target" else None, **options)
