"""`fsw calibrate` on simulated recordings: every figure is compared with the true error."""
