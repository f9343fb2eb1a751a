"""The long lane begins with its longest files, so that no worker is alone with one at the end."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent
LONGEST = (  # by `--durations=0`; one worker takes a whole file
    "offline/test_newcomer.py",
    "evidence/test_imported.py",
    "offline/test_check_wires.py",
    "hil/test_own_wires.py",
    "hil/test_vcan.py",
    "hil/test_encoders.py",
    "hil/test_soak.py",
    "hil/test_feed.py",
    "hil/test_dialects.py",
    "hil/test_fuzz.py",
    "hil/test_fault_matrix.py",
    "hil/test_wheels.py",
    "hil/test_two_arms.py",
    "hil/test_thrusters.py",
)
PLACE = {HERE / name: place for place, name in enumerate(LONGEST)}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of the longest files first; keep the order of all others."""
    if gone := [str(path) for path in PLACE if not path.exists()]:
        raise pytest.UsageError(f"the order of the long tests names {', '.join(gone)}")
    items.sort(key=lambda item: PLACE.get(item.path, len(PLACE)))
