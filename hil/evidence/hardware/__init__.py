"""What recordings of real robots show: fetched at the user's word, imported and judged as a user would."""
