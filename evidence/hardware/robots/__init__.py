"""Recorded arms: each module declares its own, `ARMS`."""
