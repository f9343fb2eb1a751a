"""`fsw report`: a recording as one page, with tables and a picture beside it."""

from fsw.commands.report.live import LIVE
from fsw.commands.report.write import Written, write_report

__all__ = ["LIVE", "Written", "write_report"]
