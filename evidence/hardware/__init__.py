"""Recordings of real arms and thrown bodies, imported and identified as by a user, and judged."""
