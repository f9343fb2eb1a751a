"""How often checks may fail a flight in which nothing is wrong, and the share of each check.

A clean flight has the sensors, bodies and priors that its configuration declares. All checks that
discard data or refuse an estimate together fail at most FLIGHT_RATE of them. Every check computes
its threshold from its share, by the number of its tests in a flight (union bound). Longer flights
fail in proportion. A conflict with the prior discards nothing: the prior is widened, and the
estimate waits until it has fitted again, so its rate stands apart. `docs/false_alarms.md` derives
all rates.
"""

from collections.abc import Mapping

from scipy.special import ndtri

FLIGHT_RATE = 1e-4  # clean flights that any check fails
BLOCKS = 200  # windows of a flight: 80 s at 0.4 s; passes over the blocks are fewer
SENSORS = 25  # sensors judged one by one: joints, accelerometer and gyro
PRIOR_TESTS = 200  # groups of the prior times the independent looks at each of them
PACES = 20_000  # bins of 0.05 s, and longer ones: of SYNC and its answers, of three kinds of nodes
CHANGES = 60 * 6 * BLOCKS // 2  # constants of sensors, courses, and looks: every second window
SAMPLES = 2_000_000  # samples of all channels: 19 channels at 500 Hz for 80 s, and spare

SHARES: dict[str, float] = {
    "gate": 1e-5,  # one block left out
    "outside": 1e-5,  # one block mistaken for a wrench from outside
    "change": 1e-5,  # Page's sum: the estimate is re-opened
    "sensor": 5e-6,  # one sensor of one block left out
    "slow": 1e-5,  # slow power of residuals: MODEL_MISMATCH
    "colour": 1e-5,  # correlation between blocks: MODEL_MISMATCH
    "level": 1e-5,  # the noise level is believed to be above the declared one
    "consistency": 5e-6,  # a body far from any possible one: NOT_CONSISTENT
    "sample": 5e-6,  # one sample left out of a window
    "health": 5e-6,  # stuck sensors, gyro against star tracker
    "pace": 5e-6,  # stamps of SYNC that creep: the bus's answers are refused
    "drift": 1e-5,  # what is declared exact or constant creeps: MODEL_MISMATCH
}
DELAYS: dict[str, float] = {  # clean flights whose estimate becomes valid later
    "prior": 2e-3,  # a group of the prior contradicted: PRIOR_CONFLICT
    "creep": 1e-1,  # sigma is wider by a change that only seems to be there
}
TESTS: Mapping[str, int] = {
    "sensor": BLOCKS * SENSORS,
    "prior": PRIOR_TESTS,
    "drift": CHANGES,
    "creep": CHANGES,
    "sample": SAMPLES,
    "pace": PACES,
    "health": SAMPLES,
}


def per_test(check: str) -> float:
    """Return the probability with which one test of a check may fail in a clean flight."""
    return rate(check) / TESTS.get(check, BLOCKS)


def rate(check: str) -> float:
    """Return the share of clean flights that a check fails or delays."""
    return (SHARES | DELAYS)[check]


def sigmas(check: str, *, sides: int = 1) -> float:
    """Return the standard normal value that one test of a check exceeds with its probability."""
    return float(-ndtri(per_test(check) / sides))
