"""Names of the recorder's files: recording_0001.mcap, and recording_0001_0002.mcap for a part."""

import re

NAME = re.compile(r"(?P<first>recording_(?P<number>\d{4,}))(?:_(?P<part>\d{4,}))?\.mcap")


def is_recording(name: str) -> bool:
    """Return whether a file's name is one that the recorder gives."""
    return NAME.fullmatch(name) is not None
