"""Names of the conditions of secrecy measurements: who reads the message, and by what means."""

from __future__ import annotations

OWNER = "the owner's decoder"
RANDOM = "random weights"
OTHER_START = "the method's start, another key"
OWN_START = "the method's start, the right seed"
COVER_ITSELF = "the cover itself"
OPEN = "no secret at all: public attributes"
WRONG = (RANDOM, OTHER_START, OWN_START, COVER_ITSELF)
"""Readers that know nothing of the message; OWN_START knows the training's seed, if the training had no key."""

SURROGATE = "surrogate: a decoder trained on views that leaked"
LINEAR = "surrogate: least squares on views that leaked"
PAINTED = "surrogate: views that leaked, painted onto Gaussians that the cover hardly shows"
SURROGATES = (SURROGATE, LINEAR, PAINTED)
BLIND = "blind: {}"
"""The severity of surrogates is the share of the training views that leaked, from 0 to 1; of blind readings it is 0."""

VIEWS_SEEN, LOSS = "views_seen", "loss"
"""Quantities: the number of leaked views, and a surrogate's mean squared error on them over its last steps."""

NOTHING_HIDDEN = "{}, nothing hidden"
"""A blind reading of a container without a message, compared with the message nonetheless: the control for chance."""

SHOWN = 3
"""The number of channels that a person can view at once, as red, green and blue."""

CHANNELS = "first channels"
COMPONENTS = "principal components"
UNEXPLAINED = "what the cover does not explain"
IGNORED = "what the scene decoder ignores"
APART = "Gaussians that the cover hardly shows, by themselves"
HEEDED = "those, by what the scene decoder heeds"
SURFACES = "where those stand"
ALL = "all channels together"
"""Readings of the feature map: three channels as in the paper, those by which a blind reader finds more than the cover,
and those from renders of some Gaussians alone."""

CHANNEL, COMPONENT = "channel {}", "principal component {}"
LINES = (
    *(CHANNEL.format(number + 1) for number in range(SHOWN)),
    *(COMPONENT.format(number + 1) for number in range(SHOWN)),
    CHANNELS,
    COMPONENTS,
    ALL,
)
"""Readings correlated with cover and message, in the table's order; the last three by multiple correlation."""
