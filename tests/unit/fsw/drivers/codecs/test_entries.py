"""How a codec is found; one that lies outside the tree, as pip installs it, is read."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fsw.config import ImuConfig, StarTrackerConfig
from fsw.drivers.codecs import entries
from fsw.drivers.codecs.kvh import KvhCodec
from fsw.drivers.codecs.sagitta import SagittaCodec
from fsw.drivers.sources import ImuSource
from fsw.drivers.wire import ByteChunk
from fsw.errors import ConfigError
from offline.init.devices import codec_listing, library
from tests.support.driver_configs import imu_config

FOREIGN = '''
"""A unit of nobody: `55 | counter U16 | 6 x I16 | sum of the bytes before, modulo 256`."""

import struct

from fsw.drivers.codecs.framing import FixedMatcher, Framer
from fsw.drivers.codecs.imu_datagram import ImuCodec, ImuDatagram, scaled


class Codec(ImuCodec):
    title = "a unit of nobody"
    devices = {"nobody_1": {"title": "Nobody 1", "source": "none", "verified": False}}
    frame_bytes = (16, 16)
    rates_hz = (100.0, 200.0)
    tick_s = 1e-3
    modulus = 65536

    def __init__(self, step_rad_s: float = 1e-3) -> None:
        self.framer = Framer(FixedMatcher(b"\\x55", 16, lambda f: sum(f[:-1]) % 256 == f[-1]))
        self._step_rad_s = step_rad_s

    def decode(self, frame):
        counter, *values = struct.unpack("<xH6hx", frame.data)
        w, f = scaled(values[:3], self._step_rad_s), scaled(values[3:], 1e-2)
        return ImuDatagram(counter, 0.0, w, f)
'''


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """Put a package with one codec beside the tree, with the metadata that pip writes."""
    (tmp_path / "nobodys_unit.py").write_text(FOREIGN)
    info = tmp_path / "nobodys_unit-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: nobodys-unit\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[fsw.imu]\nnobody = nobodys_unit:Codec\n")
    monkeypatch.syspath_prepend(tmp_path)
    clear()
    yield info
    sys.modules.pop("nobodys_unit", None)
    monkeypatch.undo()
    clear()


def clear() -> None:
    entries.installed.cache_clear()
    library.cache_clear()


def datagram(k: int) -> bytes:
    body = b"\x55" + np.array([10 * k, 100, -200, 300, 0, 0, 981], "<i2").tobytes()
    return body + bytes((sum(body) % 256,))


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize("driver", ["nobody", "nobodys_unit:Codec"])
def test_a_codec_outside_the_tree_reads_bytes(driver: str):
    config = imu_config(driver=driver, rate_hz=100.0, options={"step_rad_s": 1e-4})
    source = ImuSource(config)
    chunks = [ByteChunk(10**12 + 10_000_000 * k, b"\x55?" + datagram(k)) for k in range(300)]
    samples = source.feed(chunks)
    np.testing.assert_allclose(samples.w_NS_S_rad_s[-1], [0.01, -0.02, 0.03])
    np.testing.assert_allclose(samples.f_NS_S_m_s2[-1], [0.0, 0.0, 9.81])
    counts = source.counters
    assert (counts["accepted"], counts["reject_crc"], counts["skipped_bytes"]) == (300, 299, 600)


@pytest.mark.usefixtures("foreign")
def test_it_is_listed_with_where_it_is_from_and_its_units_are_offered():
    words = "imu nobody: a unit of nobody; nobodys_unit:Codec of nobodys-unit 1.0"
    assert words in codec_listing().splitlines()
    assert "  step_rad_s: float = 0.001" in codec_listing().splitlines()
    assert library()["imu"]["nobody_1"]["driver"] == "nobody"
    assert library()["imu"]["stim300"]["driver"] == "stim300"


def test_a_package_that_cannot_be_loaded_hurts_no_other(foreign: Path):
    (foreign / "entry_points.txt").write_text(
        "[fsw.imu]\nmissing = no_such_module:Codec\nnothing = json:loads\n"
    )
    clear()
    assert "imu stim300" in codec_listing()
    assert "No module named 'no_such_module'" in codec_listing()
    for driver, words in {
        "missing": "imu.driver: 'missing' cannot be loaded: No module named 'no_such_module'",
        "nothing": "imu.driver: 'nothing' is not a codec class",
    }.items():
        with pytest.raises(ConfigError, match=words):
            entries.imu_codec(imu_config(driver=driver))


def test_one_name_of_two_packages_is_refused(foreign: Path):
    (foreign / "entry_points.txt").write_text("[fsw.imu]\nmip = nobodys_unit:Codec\n")
    clear()
    with pytest.raises(ConfigError, match="'mip' is ambiguous: nobodys_unit:Codec of nobodys-unit"):
        entries.imu_codec(imu_config(driver="mip"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"driver": "stim30"}, "imu.driver: 'stim30'; did you mean 'stim300'? installed are"),
        ({"driver": "no_module:Codec"}, "imu.driver: 'no_module:Codec' cannot be loaded"),
        ({"driver": "pathlib:PurePath"}, "'pathlib:PurePath' is not a codec class"),
        ({"driver": "kvh"}, "imu.options.rotation: missing"),
        ({"driver": "stim300", "options": {"speed": 1}}, "imu.options.speed: unknown key"),
        (
            {"driver": "kvh", "options": {"rotation": "turns", "acceleration": "value"}},
            "imu.options.rotation: must be 'rate' or 'delta'",
        ),
        ({"driver": "novatel", "options": {"unit": 33}}, "imu.options: unit: 33; must be one of"),
    ],
)
def test_a_wrong_driver_or_option_is_one_line(changes, words):
    with pytest.raises(ConfigError) as caught:
        entries.imu_codec(imu_config(**changes))
    assert words in str(caught.value)


def test_keys_of_the_section_and_options_reach_the_codec():
    options = {"rotation": "delta", "acceleration": "value"}
    codec = entries.imu_codec(imu_config(driver="kvh", rate_hz=250.0, options=options))
    assert isinstance(codec, KvhCodec)
    assert codec.tick_s == 4e-3
    plain, lines = (entries.imu_codec(imu_config(crlf=crlf)) for crlf in (False, True))
    assert plain.frame_bytes == (28, 63)
    assert lines.frame_bytes == (30, 65)


def test_a_configuration_without_a_driver_means_what_it_did():
    assert ImuConfig.model_fields["driver"].default == "stim300"
    assert StarTrackerConfig.model_fields["driver"].default == "sagitta"
    assert entries.codec_class("star_tracker", "sagitta") is SagittaCodec
