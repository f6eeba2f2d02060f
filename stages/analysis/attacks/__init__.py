"""Attacks on containers: what a thief may do to what an owner has published, one file a family."""
