"""Attacks on published containers, one module for each family of attacks."""
