"""Speed: benchmarks beside references."""
