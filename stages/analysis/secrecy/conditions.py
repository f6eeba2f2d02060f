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
PAINTED = "surrogate: views that leaked, painted onto Gaussians that the cover hardly shows"
SURROGATES = (SURROGATE, LINEAR, PAINTED)
BLIND = "blind: {}"
"""Severity: the share of the training views that leaked, from 0 to 1. A blind reading has seen none."""

VIEWS_SEEN, LOSS = "views_seen", "loss"
"""Quantities: how many views a share comes to, and a surrogate's mean squared error there, over its last steps."""

NOTHING_HIDDEN = "{}, nothing hidden"
"""A blind reading of a container without a message, compared with the message all the same: what chance comes to."""

SHOWN = 3
"""Channels that a person can look at at once."""

CHANNELS = "first channels"
COMPONENTS = "principal components"
UNEXPLAINED = "what the cover does not explain"
IGNORED = "what the scene decoder ignores"
APART = "Gaussians that the cover hardly shows, by themselves"
HEEDED = "those, by what the scene decoder heeds"
SURFACES = "where those stand"
ALL = "all channels together"
"""Of the feature map: three channels, as the paper shows it, and as a blind reader finds more in it than the cover; and
of what is rendered of some Gaussians alone."""

CHANNEL, COMPONENT = "channel {}", "principal component {}"
LINES = (
    *(CHANNEL.format(number + 1) for number in range(SHOWN)),
    *(COMPONENT.format(number + 1) for number in range(SHOWN)),
    CHANNELS,
    COMPONENTS,
    ALL,
)
"""What is correlated with cover and message, in the order of the table; the last three by multiple correlation."""
