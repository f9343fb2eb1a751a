"""Every parser under its oracle: what fuzzing has grown, and a short campaign of the same code."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from evidence.fuzz.oracle import OracleError, chunks, segments
from evidence.fuzz.seeds import seeds
from evidence.fuzz.table import TARGETS, make, quota

CORPUS = Path(__file__).parents[2] / "corpus"
CI_INPUTS = 2_000  # `hil fuzz --inputs 1e7` is the campaign
needs_atheris = pytest.mark.skipif(
    importlib.util.find_spec("atheris") is None, reason="needs atheris"
)


@pytest.mark.parametrize("name", TARGETS)
def test_what_fuzzing_has_found_stays_found(name: str) -> None:
    one = make(name)
    inputs = [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]
    assert inputs
    for data in [b"", *seeds(name), *inputs]:
        one(data)


def test_an_input_is_segments_and_some_are_sealed() -> None:
    data = b"\x03\x02ab" + b"\x00\x01c" + b"\x02\x01d" + b"\x01\x09short"
    assert list(segments(data)) == [(3, b"ab"), (0, b"c"), (2, b"d"), (1, b"short")]
    assert chunks(data, bytes.upper) == [b"AB", b"cd", b"SHORT"]


def test_every_target_gets_its_least_share() -> None:
    shares = quota(10_000_000)
    assert min(shares.values()) >= 500_000
    assert sum(shares.values()) >= 10_000_000


def test_the_oracle_sees_a_framer_that_loses_a_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    from fsw.drivers.codecs.framing import Framer

    skip = Framer._skip
    monkeypatch.setattr(Framer, "_skip", lambda self, a, b, why: skip(self, a, max(a, b - 1), why))
    with pytest.raises(OracleError, match="loses bytes"):
        make("stim300")(b"\x00\x05hello")


@pytest.mark.slow
@needs_atheris
@pytest.mark.timeout(600)
def test_a_short_campaign_finds_nothing_and_is_resumed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil", "fuzz", "--seed", "1", "--out", str(tmp_path)]
    command.append("--inputs")
    done = subprocess.run([*command, str(CI_INPUTS)], capture_output=True, text=True, check=False)
    result = json.loads(done.stdout)
    assert result["failed"] == [], result
    assert result["inputs"] >= CI_INPUTS
    again = subprocess.run([*command, str(CI_INPUTS)], capture_output=True, text=True, check=False)
    assert json.loads(again.stdout) == result  # nothing was left to do
