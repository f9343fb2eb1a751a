"""Where keys may come from, and which are refused."""

from pathlib import Path

import pytest

from fsw.config import load
from fsw.config.sdls import SdlsConfig
from fsw.errors import ConfigError
from fsw.telemetry.link.sdls_keys import load_associations

KEY = bytes(range(32))


@pytest.fixture
def config(arm):
    return load(arm.write())


def slot_files(config, *contents: bytes, mode: int = 0o600) -> SdlsConfig:
    slots = []
    for spi, content in enumerate(contents, start=1):
        path = config.resolve(Path(f"key{spi}"))
        path.write_bytes(content)
        path.chmod(mode)
        slots.append({"spi": spi, "file": f"key{spi}"})
    return SdlsConfig.model_validate({"keys": slots})


def test_two_files_are_two_associations(config):
    sdls = slot_files(config, KEY, KEY[::-1])
    found = load_associations(config, sdls, {})
    assert [(item.spi, item.key) for item in found] == [(1, KEY), (2, KEY[::-1])]


def test_a_key_shows_in_no_message(config):
    (found,) = load_associations(config, slot_files(config, KEY), {})
    assert repr(KEY) not in repr(found)
    assert KEY.hex() not in repr(found)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o601])
def test_a_key_open_to_others_is_refused(config, mode):
    with pytest.raises(ConfigError, match="0600"):
        load_associations(config, slot_files(config, KEY, mode=mode), {})


@pytest.mark.parametrize("content", [b"", KEY[:31], KEY + b"\n"])
def test_a_key_of_another_length_is_refused(config, content):
    with pytest.raises(ConfigError, match="32 bytes"):
        load_associations(config, slot_files(config, content), {})


def test_the_same_key_twice_is_refused(config):
    with pytest.raises(ConfigError, match="another slot"):
        load_associations(config, slot_files(config, KEY, KEY), {})


def test_a_missing_file_is_named(config):
    sdls = SdlsConfig.model_validate({"keys": [{"spi": 1, "file": "nowhere.key"}]})
    with pytest.raises(ConfigError, match=r"nowhere\.key"):
        load_associations(config, sdls, {})


def test_a_credential_is_read_where_systemd_puts_it(config, tmp_path):
    folder = tmp_path / "credentials"
    folder.mkdir()
    (folder / "uplink").write_bytes(KEY)
    (folder / "uplink").chmod(0o440)  # an access list makes systemd's files look so
    sdls = SdlsConfig.model_validate({"keys": [{"spi": 1, "credential": "uplink"}]})
    (found,) = load_associations(config, sdls, {"CREDENTIALS_DIRECTORY": str(folder)})
    assert found.key == KEY
    with pytest.raises(ConfigError, match="CREDENTIALS_DIRECTORY"):
        load_associations(config, sdls, {})


@pytest.mark.parametrize(
    "keys",
    [
        [],
        [{"spi": 1}],
        [{"spi": 1, "file": "a", "credential": "b"}],
        [{"spi": 0, "file": "a"}],
        [{"spi": 1, "file": "a"}, {"spi": 1, "file": "b"}],
        [{"spi": i, "file": str(i)} for i in (1, 2, 3)],
    ],
)
def test_slots_that_make_no_sense_are_refused(keys):
    with pytest.raises(ValueError, match="keys"):
        SdlsConfig.model_validate({"keys": keys})
