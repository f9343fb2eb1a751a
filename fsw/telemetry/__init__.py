"""Telemetry and telecommands: packets, services, link, tables, monitors, events."""
