"""`hil mistakes`: run every mistake with target, base or both unknown; report a line for each."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from evidence.mistakes.run import Finding, run
from evidence.mistakes.table import NONE, NONE_WIRED, mistakes
from hil.world.scenario import ScenarioError

CASES = ("target", "base", "both")
CORRECT = (NONE, NONE_WIRED)
CLAMPED = "bench_target"  # under gravity
NAMED_SHARE = 0.9  # least share of the harmful mistakes whose cause is named


def findings(
    cases: Sequence[str],
    only: Sequence[str],
    seed: int,
    *,
    exact: bool,
    robot: str = "",
    recording: bool = False,
) -> Iterator[Finding]:
    """Yield the result of every mistake; `robot` is a scenario file, or empty for the bench's.

    Raises
    ------
    ScenarioError for an unknown name of a mistake or case.
    """
    every = CASES if robot else (*CASES, CLAMPED)
    for names, known in ((only, tuple(mistakes())), (cases, every)):
        for name in names:
            if name not in known:
                raise ScenarioError(f"{name!r} must be one of {', '.join(known)}")
    for case in cases or every:
        own = f"{robot}:{case}" if robot else case
        for name in only or mistakes():
            yield run(own, name, seed, exact=exact, recording=recording)


def summary(found: Sequence[Finding]) -> tuple[str, bool]:
    """Return a line that counts the results, and whether they are within their bounds.

    No output may be valid and wrong, and no recording passed that check calls wrong. Of the
    mistakes that do harm, nine of ten must be named; and a correct configuration must not be called
    wrong.
    """
    wrong = sum(own.confidently_wrong for own in found)
    text = f"{wrong} of {len(found)} valid and wrong"
    recorded = [own for own in found if own.recorded or own.refused]
    if not recorded:
        return text, not wrong
    harmful = [own for own in recorded if own.mistake not in CORRECT and not own.harmless]
    named = sum(own.named for own in harmful)
    right = [own for own in recorded if own.mistake in CORRECT]
    false = sum(bool(own.findings) for own in right)
    text += f"; {named} of {len(harmful)} harmful ones named by check"
    text += f"; {false} of {len(right)} correct ones called wrong"
    passed = sum(own.passed_though_wrong for own in recorded)
    text += f"; {passed} passed by identify where check says WRONG"
    fits = not (wrong or false or passed)
    return text, fits and named >= NAMED_SHARE * len(harmful)


def line(found: Finding) -> str:
    """Return the result of a mistake as one line of text."""
    case = found.case.rpartition(":")[2]
    if found.refused:
        return f"{case:6} {found.mistake:34} refused: {found.refused}"
    mark = "WRONG" if found.confidently_wrong else ""
    mark += " PASSED THOUGH WRONG" * found.passed_though_wrong
    state = "valid" if found.valid else found.reason
    named = {True: "named", False: "NOT NAMED"}[found.named]
    named = "harmless" if found.harmless else named
    recorded = (
        f"; recorded {found.recorded} {found.recorded_z:.1f}, {named}" if found.recorded else ""
    )
    return (
        f"{case:6} {found.mistake:34} {state:22} {found.z:7.1f} sigma, mass "
        f"{found.mass_z:6.1f} of +-{found.mass_sigma:.2%}; {found.outputs} valid, {found.wrong} "
        f"wrong; batch {found.batch} {found.batch_z:.1f}{recorded} {mark}"
    ).rstrip()


def run_all(
    *,
    case: Sequence[str],
    only: Sequence[str],
    seed: int,
    exact: bool,
    robot: str,
    recording: bool,
    as_json: bool,
) -> int:
    """Print a line for each mistake and the summary; return the exit code, 0 if it passed."""
    found = []
    for one in findings(case, only, seed, exact=exact, robot=robot, recording=recording):
        found.append(one)
        if not as_json:
            print(line(one), flush=True)
    text, passed = summary(found)
    print(json.dumps([asdict(one) for one in found]) if as_json else text)
    return 0 if passed else 1
