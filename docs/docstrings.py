"""Extension of mkdocstrings: sections as this project writes them, one line each, read as numpydoc.

A parameter here is `name : words`, and its type stands in the signature; numpydoc expects words on
a line of their own.
"""

import re
from typing import Any

import griffe

SECTION = re.compile(r"^(Parameters|Raises)\n-+\n(.*?)(?=\n\n|\Z)", re.MULTILINE | re.DOTALL)


class OwnLines(griffe.Extension):
    """Puts the words of parameters and errors on lines of their own."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:  # noqa: ANN401  # as griffe has it
        """Rewrite one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = SECTION.sub(_own_lines, obj.docstring.value)


def _own_lines(found: re.Match[str]) -> str:
    title, body = found.groups()
    if title == "Raises":
        name, _, words = " ".join(body.split()).partition(" ")
        body = f"{name}\n    {words}"
    else:
        parts = re.split(r"^(\w[\w, ]*) : ", body, flags=re.MULTILINE)[1:]
        pairs = zip(parts[::2], parts[1::2], strict=True)  # names and their words
        one = [f"{n}\n    {' '.join(w.split())}" for names, w in pairs for n in names.split(", ")]
        body = "\n".join(one)
    return f"{title}\n{'-' * len(title)}\n{body}"
