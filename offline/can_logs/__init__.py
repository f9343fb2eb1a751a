"""Logs of CAN buses by other tools: their frames, in the form of the ports."""
