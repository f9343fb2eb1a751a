"""File transfers in a row, many of them interrupted: each must end right or with its reason."""
