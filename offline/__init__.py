"""Tools beside the flight software: they read recordings, write configurations and reports.

None of them flies; `fsw --help` has an entry for each. `api.py` is the Python API.
"""
