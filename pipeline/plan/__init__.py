"""What a run would do and why: keys, and what differs from earlier results."""
