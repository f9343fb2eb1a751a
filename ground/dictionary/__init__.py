"""The dictionary of telemetry and telecommands, as XTCE, COSMOS and ccsdspy tables."""

from pathlib import Path

XTCE = Path(__file__).parent / "inertia.xml"
