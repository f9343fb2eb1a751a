"""Hardware-in-the-loop bench: truth, simulated devices, faults and scenarios."""
