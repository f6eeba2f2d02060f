"""The page about a batch: one row for each of its items, failed ones included."""
