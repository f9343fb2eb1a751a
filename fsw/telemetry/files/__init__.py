"""Files: CFDP class 2 in both directions."""
