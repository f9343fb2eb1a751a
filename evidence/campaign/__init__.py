"""Monte Carlo campaigns over seeds, noise, trajectories and robots, on this machine or on Dask."""

from pathlib import Path

from evidence.declaration import declared, option
from hil.options import count

COMMAND = declared(
    "campaign",
    "Monte Carlo over what a YAML file names",
    "hil campaign evidence/campaign/examples/target.yaml --out runs/campaign",
    "evidence.campaign.command:campaign",
    option("path", type=Path, metavar="CAMPAIGN.yaml"),
    option("--out", type=Path, metavar="DIR", help="results; resumed if there"),
    option("--workers", type=count, default=2, metavar="N", help="processes, 2"),
    option("--scheduler", metavar="ADDRESS", help="of a Dask cluster, instead"),
)
