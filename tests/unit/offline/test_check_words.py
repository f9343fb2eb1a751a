"""The last line of `fsw check CONFIG RECORDING` says no more than the data show."""

from dataclasses import replace

from fsw.config import load
from offline.check_recording import ALL_FITS, _residual_words
from offline.checks.explanation import Verdict


def test_data_without_a_residual_are_not_said_to_fit(arm):
    config = load(arm.write())
    names = {"found": (), "nearest": (), "tried": 0, "mounting": "", "doubtful": ""}
    fits = Verdict(before=0.9, after=0.9, **names)
    assert _residual_words(fits, config).startswith(f"{ALL_FITS}: fit (residuals 0.949 times")
    empty = _residual_words(replace(fits, before=2e-31), config)
    assert empty == f"WRONG: {ALL_FITS}: not judged; no torque, rate or specific force is used"
