"""Toy stages that are slow enough to be killed, and that crash, shout and wait."""
