"""Services: one module per PUS service."""
