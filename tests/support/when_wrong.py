"""The rows of docs/howto/when_wrong.md: mistake, command, words of the line that it prints."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "when_wrong.md"
PART = re.compile(r"^## (?:[^`\n]*`(fsw .+)`|Other .+)\n((?:(?!## ).*\n)*)", re.MULTILINE)
ROW = re.compile(r"^\| (.+?) \|(?: `(fsw .+?)` \|)? `(.+)` \|$", re.MULTILINE)
ROWS = [
    (mistake, command or of_part, words)
    for of_part, part in PART.findall(PAGE.read_text(encoding="utf-8"))
    for mistake, command, words in ROW.findall(part)
]
