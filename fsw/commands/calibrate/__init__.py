"""`fsw calibrate`: what a recording shows of sensors and mounting, as a configuration overlay."""
