"""Run a command with a real vcan0 and vcan1: on this kernel, or in User-Mode Linux."""
