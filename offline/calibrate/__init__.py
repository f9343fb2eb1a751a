"""`fsw calibrate`: estimate errors of sensors and mounting; write a configuration overlay."""
