"""What a check says of a spoiled configuration."""

import pytest

from fsw.checks.configuration import validate
from fsw.config import load
from fsw.errors import ConfigError


def fault(arm, check=validate):
    config = load(arm.write())
    with pytest.raises(ConfigError) as caught:
        check(config)
    message = str(caught.value)
    assert all(line.startswith(config.name + ": ") for line in message.splitlines()), message
    return message


def assert_named(message, *words):
    assert [word for word in words if word not in message] == [], message
