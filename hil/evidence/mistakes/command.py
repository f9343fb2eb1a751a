"""`hil mistakes`: run every mistake with target, base or both unknown; report a line for each."""

from collections.abc import Iterator, Sequence

from hil.evidence.mistakes.run import Finding, run
from hil.evidence.mistakes.table import mistakes
from hil.world.scenario import ScenarioError

CASES = ("target", "base", "both")


def findings(
    cases: Sequence[str], only: Sequence[str], seed: int, *, exact: bool, robot: str = ""
) -> Iterator[Finding]:
    """Yield the result of every mistake; `robot` is a scenario file, or empty for the bench's.

    Raises
    ------
    ScenarioError for an unknown name of a mistake or case.
    """
    for names, known in ((only, tuple(mistakes())), (cases, CASES)):
        for name in names:
            if name not in known:
                raise ScenarioError(f"{name!r} must be one of {', '.join(known)}")
    for case in cases or CASES:
        for name in only or mistakes():
            yield run(f"{robot}:{case}" if robot else case, name, seed, exact=exact)


def line(found: Finding) -> str:
    """Return the result of a mistake as one line of text."""
    case = found.case.rpartition(":")[2]
    if found.refused:
        return f"{case:6} {found.mistake:34} refused: {found.refused}"
    mark = "WRONG" if found.confidently_wrong else ""
    state = "valid" if found.valid else found.reason
    return (
        f"{case:6} {found.mistake:34} {state:22} {found.z:7.1f} sigma, mass "
        f"{found.mass_z:6.1f} of +-{found.mass_sigma:.2%}; {found.outputs} valid, {found.wrong} "
        f"wrong; batch {found.batch} {found.batch_z:.1f} {mark}"
    ).rstrip()
