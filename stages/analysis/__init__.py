"""What is measured about a container: attacks, detectors, curves."""
