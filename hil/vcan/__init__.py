"""Run a command with real CAN links vcan0 and vcan1, on this kernel or in User-Mode Linux."""
