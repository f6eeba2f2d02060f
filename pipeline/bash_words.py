"""Completion in bash, which parts words at `=` and `:` and wants to hear the last part alone.

For `--set hide.method=sh` bash asks with the words `--set`, `hide.method`, `=` and `sh`, and puts what it is offered in
the place of `sh`. Whoever has taken these signs from COMP_WORDBREAKS is asked, and answered, with whole words.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import contextmanager, redirect_stdout

BREAK = re.compile("[=:]+")


@contextmanager
def whole_words(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Has the program asked with whole words, and what it prints meanwhile told as bash wants it.

    `environment` is what the shell's script sets: COMP_WORDS has a line for each word, and COMP_CWORD is the number of
    the word that is to be completed.
    """
    words, last = joined(environment["COMP_WORDS"].split("\n"), int(environment["COMP_CWORD"]))
    environment["COMP_WORDS"], environment["COMP_CWORD"] = "\n".join(words), str(len(words) - 1)
    known, said = words[-1].removesuffix(last), io.StringIO()
    if known.startswith("--"):
        known = known.partition("=")[2]  # what is offered for `--set=hide.` is offered without the option
    try:
        with redirect_stdout(said):
            yield
    finally:  # the program ends by SystemExit
        print("".join(line.removeprefix(known) for line in said.getvalue().splitlines(keepends=True)), end="")


def joined(words: Sequence[str], current: int) -> tuple[list[str], str]:
    """The words up to the one at index `current`, whole, and the part of the last one that bash would replace.

    >>> joined(["run", "--set", "a.b", "=", "c"], 4), joined(["run", "--set", "a.b", "="], 3), joined(["run", ""], 1)
    ((['run', '--set', 'a.b=c'], 'c'), (['run', '--set', 'a.b='], ''), (['run', ''], ''))
    """
    whole: list[str] = []
    open_ended = False
    for word in words[: current + 1]:
        is_break = BREAK.fullmatch(word) is not None
        if whole and word and (is_break or open_ended):
            whole[-1] += word
        else:
            whole.append(word)
        open_ended = is_break
    return whole, "" if open_ended else words[current] if current < len(words) else ""
