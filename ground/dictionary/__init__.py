"""The daemon's dictionary as it is given to everyone: XTCE, COSMOS, ccsdspy tables."""

from pathlib import Path

XTCE = Path(__file__).parent / "inertia.xml"
