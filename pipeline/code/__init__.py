"""The code of stages: what they declare, and the digest of the code that their results depend on."""
