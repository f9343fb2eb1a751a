"""What recordings of real arms show: fetched if wanted, imported and judged as by a user."""
