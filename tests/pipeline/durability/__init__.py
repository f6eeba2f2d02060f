"""Attempts to destroy runs and stores: kills, full disks, signals, crashes, damage, and several runs at once."""
