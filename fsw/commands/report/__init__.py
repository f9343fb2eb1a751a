"""`fsw report`: write a recording as one HTML page, with optional tables and a picture."""

from fsw.commands.report.live import LIVE
from fsw.commands.report.write import Written, write_report

__all__ = ["LIVE", "Written", "write_report"]
