"""Completion in bash, which splits words at `=` and `:` and expects only the last part in return.

For `--set hide.method=sh`, bash passes the words `--set`, `hide.method`, `=` and `sh`, and replaces `sh` with what it
is offered. If the user has removed these characters from COMP_WORDBREAKS, bash passes and expects whole words.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import contextmanager, redirect_stdout

BREAK = re.compile("[=:]+")


@contextmanager
def whole_words(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Lets the program complete whole words, and reduces what it prints meanwhile to what bash expects.

    `environment` is as the shell's script sets it: COMP_WORDS has one word per line, and COMP_CWORD is the index of the
    word to complete.
    """
    words, last = joined(environment["COMP_WORDS"].split("\n"), int(environment["COMP_CWORD"]))
    environment["COMP_WORDS"], environment["COMP_CWORD"] = "\n".join(words), str(len(words) - 1)
    known, said = words[-1].removesuffix(last), io.StringIO()
    if known.startswith("--"):
        known = known.partition("=")[2]  # completions of `--set=hide.` come without the option
    try:
        with redirect_stdout(said):
            yield
    finally:  # the program ends with SystemExit
        print("".join(line.removeprefix(known) for line in said.getvalue().splitlines(keepends=True)), end="")


def joined(words: Sequence[str], current: int) -> tuple[list[str], str]:
    """The words up to index `current`, joined again, and the part of the last one that bash would replace.

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
