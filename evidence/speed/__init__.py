"""Speed: benchmarks of the flight software, each compared with a reference."""
