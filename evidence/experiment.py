"""Cases x seeds -> work -> rows -> one line for each kind: what the studies over seeds declare."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypedDict, TypeVar

from evidence import runner
from evidence.store import Row, Store
from evidence.terminal import WRONG, print_table

C = TypeVar("C")
Kind = tuple[str, ...]  # what the cases of a line have in common, as words
Line = dict[str, Any]  # figures over the seeds of a kind, with `passed`


class Over(TypedDict):
    """The options that every study over seeds has."""

    first: int
    count: int
    jobs: int
    out: Path | None
    as_json: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment(Generic[C]):
    """A study over seeds.

    Attributes
    ----------
    case : makes a case of the words of a kind and a seed; its text is its key in the store
    summary : makes the lines of a kind of the rows of its cases
    cells : makes the cells of a line, one for each of `columns`
    note : makes the text below the table of all lines
    """

    name: str
    settings: Mapping[str, Any]  # values on which every row depends, besides its key and the code
    case: Callable[..., C]
    work: Callable[[C], Mapping[str, Row]]
    summary: Callable[[Kind, Sequence[Row]], Sequence[Line]]
    title: str
    columns: Sequence[str]
    cells: Callable[[Line], Sequence[str]]
    width: int = 130  # of the table, in characters
    note: Callable[[Sequence[Line]], str] = lambda _lines: WRONG

    def missing(self, kinds: Sequence[Kind], seeds: Sequence[int], out: Path | None) -> list[C]:
        """Return the cases that the folder lacks. Raises ScenarioError as `lines`."""
        return runner.missing(self._cases(kinds, seeds), str, Store(out, self.settings))

    def lines(
        self, kinds: Sequence[Kind], seeds: Sequence[int], jobs: int, out: Path | None
    ) -> list[Line]:
        """Run the cases that the folder lacks; return the lines of all kinds.

        Raises
        ------
        ScenarioError if the folder holds results of another study; errors of `work`.
        """
        store = Store(out, self.settings)
        runner.rows(self.name, self.work, self._cases(kinds, seeds), store, jobs)
        return [
            line
            for kind in kinds
            for line in self.summary(kind, [store.rows[str(self.case(*kind, s))] for s in seeds])
        ]

    def run(self, kinds: Sequence[Kind], over: Over) -> int:
        """Print the lines; return the exit code, 0 if every line passed."""
        seeds = range(over["first"], over["first"] + over["count"])
        lines = self.lines(kinds, seeds, over["jobs"], over["out"])
        return self.judged(lines, as_json=over["as_json"])

    def judged(self, lines: Sequence[Line], *, as_json: bool) -> int:
        """Print the lines; return the exit code, 0 if every line passed."""
        if as_json:
            print(json.dumps(lines))
        else:
            cells = [self.cells(line) for line in lines]
            print_table(self.title, self.columns, cells, self.width, self.note(lines))
        return 0 if all(line["passed"] for line in lines) else 1

    def _cases(self, kinds: Sequence[Kind], seeds: Sequence[int]) -> list[C]:
        return [self.case(*kind, seed) for kind in kinds for seed in seeds]
