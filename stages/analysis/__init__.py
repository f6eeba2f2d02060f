"""Measurements of containers, and the pages that report them: fidelity, attacks, secrecy, detection."""
