"""What the measurements of secrecy are told apart by: who reads, and with what."""

from __future__ import annotations

OWNER = "the owner's decoder"
RANDOM = "random weights"
OTHER_START = "the method's start, another key"
OWN_START = "the method's start, the right seed"
COVER_ITSELF = "the cover itself"
OPEN = "no secret at all: public attributes"
WRONG = (RANDOM, OTHER_START, OWN_START, COVER_ITSELF)
"""Readers that know nothing of the message; OWN_START knows what the training drew from, where that was no key."""

SURROGATE = "surrogate: a decoder trained on views that leaked"
LINEAR = "surrogate: least squares on views that leaked"
BLIND = "blind, true colours: {}"
"""Severity: the share of the training views that leaked, from 0 to 1. A blind reading has seen none."""

VIEWS_SEEN = "views_seen"
"""Quantity: how many views a share comes to."""
