"""Fault detection, isolation and recovery: from findings and windows to events and marks."""

from fsw.health.monitor import Health

__all__ = ["Health"]
