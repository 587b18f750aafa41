"""Addresses on a command line, replaced by local copies while the command runs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from egocap.errors import EgocapError
from egocap.storage.store import is_address

if TYPE_CHECKING:
    from egocap.storage.copies import Copy

log = logging.getLogger(__name__)

OUTPUT = "--out"
"""The option whose address is written; all others are read."""


@contextmanager
def local_words(words: Sequence[str], *, inputs: bool = True) -> Iterator[list[str]]:
    """The words with local paths in place of addresses.

    Inputs are fetched first; they stay addresses if `inputs` is False. Of an output what is there
    is fetched, so that an unfinished one is continued; its files are sent while the command runs
    and when it ends, however it ends. Raises FileError and MachineError.
    """
    with ExitStack() as held:
        outputs: list[Copy] = []
        found = [_local(word, words[i - 1] if i else "", outputs, held, inputs)
                 for i, word in enumerate(words)]  # fmt: skip
        try:
            with ExitStack() as sending:
                for copy in outputs:
                    sending.enter_context(copy.sending())
                yield found
        except BaseException:
            for copy in outputs:
                _send_once(copy)
            raise
        for copy in outputs:
            copy.send_all()
            print(f"{copy.store.address}: sent", file=sys.stderr)


def _local(word: str, before: str, outputs: list[Copy], held: ExitStack, inputs: bool) -> str:
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    if not is_address(value):
        return word
    from egocap.storage.copies import Copy, fetch

    if (option or before) != OUTPUT:
        return word if not inputs else f"{option}{equals}{fetch(value)}"
    copy = held.enter_context(Copy(value).held())
    copy.fetch(keep_unsent=True)
    outputs.append(copy)
    return f"{option}{equals}{copy.path}"


def _send_once(copy: Copy) -> None:
    """What is finished of a command that failed; without connection it stays in the copy."""
    try:
        copy.send()
    except EgocapError as error:
        log.warning("%s; run the same command again to send the rest", error)
