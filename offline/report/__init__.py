"""`fsw report`: write a recording as one HTML page, with optional tables and a picture."""

from offline.report.live import LIVE
from offline.report.write import Written, write_report

__all__ = ["LIVE", "Written", "write_report"]
