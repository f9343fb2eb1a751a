"""Stamps that a recording cannot hold."""

from pathlib import Path

import numpy as np
import pytest

from fsw.commands.importing.captures import refuse_disorder
from fsw.messages.errors import ConfigError


@pytest.mark.parametrize(
    ("t_ns", "words"),
    [
        ([-2_000_000_000, 0], "a stamp at -2 s; must be at least 0"),
        ([5, (1 << 63) - 1], r"a stamp at 9\.22337e\+09 s or later; must be below 9\.22337e\+09"),
    ],
)
def test_the_stamp_out_of_range_is_named(t_ns, words):
    with pytest.raises(ConfigError, match=words):
        refuse_disorder(Path("imu.csv"), np.array(t_ns, np.int64))
