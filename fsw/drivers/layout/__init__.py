"""Layouts: descriptions of signals in CAN frames, compiled to operations on arrays of frames."""
