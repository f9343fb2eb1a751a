"""Telemetry and telecommands: packets, services, files and the authenticated uplink."""
