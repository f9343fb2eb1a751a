"""The telemetry application with its link, on the machine's clock and without a loop.

python -m tests.support.telemetry_alone FOLDER  ->  its port on one line; ends with its input
"""

import select
import sys
import time
from pathlib import Path

from fsw.service.process import _epoch
from tests.conftest import ArmProject
from tests.support.application_cases import Flight, flight_config

PERIOD_S = 0.03


def main(folder: Path) -> None:
    arm = ArmProject(folder)
    config = flight_config(arm, housekeeping_interval_s=1.0)
    flight = Flight(config, now=time.monotonic_ns(), epoch=_epoch("alone"))
    flight.app.open()
    sys.stdout.write(f"{flight.app.link.server.port}\n")
    sys.stdout.flush()
    while not select.select([sys.stdin], [], [], PERIOD_S)[0]:
        flight.now = time.monotonic_ns()
        flight.up()  # the loop's summary
        flight.app.poll(flight.now)
    flight.app.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
