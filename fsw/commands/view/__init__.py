"""`fsw view`: a recording or a plan in motion, as one page with a three-dimensional scene."""

from fsw.commands.view.write import PLANS, view

__all__ = ["PLANS", "view"]
