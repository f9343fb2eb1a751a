"""Thin non-blocking shells over python-can and pyserial."""
