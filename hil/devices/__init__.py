"""Simulated devices; their encoders share no code with the flight software's decoders."""
