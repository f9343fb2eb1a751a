"""What noise the data show: its size, its colour, and what is not noise."""
