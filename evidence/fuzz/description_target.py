"""Target of descriptions of CAN frames: files of every kind, and keys of the configuration."""

import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

from evidence.fuzz.oracle import Target, require
from evidence.fuzz.text_targets import CORRECT
from fsw.config import Config, parse
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.files import NODE_SUFFIXES, SUFFIXES, read_messages, read_node
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.layout.signals import Message, faults
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.wire import MAX_DATA_BYTES, CanFrame, frame_array
from fsw.errors import ConfigError

KINDS = (*SUFFIXES, *NODE_SUFFIXES, "keys")  # by the first byte of an input
MOST_S = 10.0  # of processor time, for one input
MOST_CHARACTERS = 1000  # of a refusal
FRAMES = np.random.default_rng(1).integers(0, 256, (16, MAX_DATA_BYTES), np.uint8)
MS = 1_000_000


def decode(messages: dict[str, Message]) -> None:
    """Decode frames of any content by every message without faults."""
    for message in messages.values():
        found = list(faults(message))
        require(all(own and "\n" not in own for own in found), "a fault is no line", found)
        if found:
            continue
        columns = Decoder(message, message.signals)(FRAMES[:, : message.length])
        require(all(column.shape == (len(FRAMES),) for column in columns), "frames without a value")


def config_of(messages: bytes) -> Config:
    """Return a configuration whose joint uses the first two signals of given messages."""
    document = yaml.safe_load(CORRECT)
    del document["joints"][0]["node_id"], document["buses"]
    document["joints"][0] |= {
        "driver": "described",
        "signals": {
            "position": {"message": "m", "signal": "p", "unit": "rad"},
            "torque": {"message": "m", "signal": "t", "unit": "N m"},
        },
        "timing": {"by": "arrival", "sigma_s": 1e-4},
    }
    bus = b"buses: [{name: arm, interface: virtual, channel: c, rate_hz: 250.0, sync: none, "
    text = yaml.safe_dump(document).encode() + bus + b"messages: " + messages + b"}]\n"
    return parse(text, Path("/nowhere"), "fuzz")


def read_keys(messages: bytes) -> None:
    """Read frames by messages in the configuration."""
    config = config_of(messages)
    layouts = layouts_of(config, config.buses[0])
    source = DescribedBusSource(config.buses[0], list(enumerate(config.joints)), layouts)
    words = [source.words[k % len(source.words)] for k in range(len(FRAMES))]
    lengths = [8 if k % 3 else 64 for k in range(len(FRAMES))]
    frames = [
        CanFrame(10**12 + 4 * MS * k, word, row.tobytes()[:length], is_fd=length > 8)
        for k, (word, row, length) in enumerate(zip(words, FRAMES, lengths, strict=True))
    ]
    samples = source.feed(frame_array(frames))
    require(np.isfinite(samples.position_rad).all(), "a position is no number", samples)
    counts = source.counters
    require(counts["accepted"] == len(samples), "samples do not add up", counts)


def description_target() -> Target:
    """Return the target of descriptions; an input is a kind and the content of its file."""
    folder = Path(tempfile.mkdtemp())

    def one(data: bytes) -> None:
        kind, content = KINDS[data[0] % len(KINDS)] if data else ".dbc", data[1:]
        before_s = time.process_time()
        try:
            if kind == "keys":
                read_keys(content)
            else:
                path = folder / f"fuzz{kind}"
                path.write_bytes(content)
                decode(read_messages(path) if kind in SUFFIXES else read_node(path, 5))
        except ConfigError as error:
            lines = str(error).splitlines()
            is_short = all(len(line) < MOST_CHARACTERS for line in lines)
            require(lines and is_short, "a refusal is no short line", lines)
            require(kind == "keys" or len(lines) == 1, "a refusal of a file is not a line", lines)
        took_s = time.process_time() - before_s
        require(took_s < MOST_S, "a description takes too long", took_s)

    return one
