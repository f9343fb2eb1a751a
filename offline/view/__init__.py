"""`fsw view`: write a page with a three-dimensional scene of a recorded or planned motion."""

from offline.view.write import PLANS, view

__all__ = ["PLANS", "view"]
