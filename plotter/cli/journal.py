"""The journal as `plot` begins it and `resume` goes on with it, and what is said when it cannot be written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from output.ebb.journal import Journal, discard, journal_lock
from output.errors import BoardRefused
from plotter.cli.say import notes
from plotter.errors import BadInput
from plotter.journals import given_up, journal_path


@contextmanager
def begun(head: Mapping[str, Any] | None) -> Iterator[Journal | None]:
    """The journal of a new plot; without a place for one the plot goes on, and cannot be resumed. Nor can the one before it.

    With `head` None no journal is kept, and the one that is there stays. So it does when another plot is writing it.
    """
    if head is None:
        yield None
        return
    path = journal_path()
    with suppress(OSError):  # as is said when it is begun
        path.parent.mkdir(parents=True, exist_ok=True)
    with journal_lock(path) as ours:
        journal = _begun(path, head) if ours else None
        if not ours:
            notes(["another plot is running and keeps the journal: this one cannot be resumed"])
        if journal is None:
            yield None
            return
        with _told(journal):
            yield journal


def _begun(path: Path, head: Mapping[str, Any]) -> Journal | None:
    before = given_up()
    try:
        journal = Journal.begin(path, head)
    except OSError as error:
        notes([_without(path, error, before)])
        return None
    if before is not None:
        notes([f"{before}; this one takes its place, so that it can no longer be resumed"])
    return journal


@contextmanager
def nothing_else_running() -> Iterator[None]:
    """For a resume. Raises BoardRefused while a plot is running, whose journal is not to be gone on with."""
    with journal_lock(journal_path()) as ours:
        if not ours:
            raise BoardRefused(
                "a plot is running and keeps the journal: wait until it has ended, or end it, then `plotter resume`"
            )
        yield


@contextmanager
def gone_on_with() -> Iterator[Journal]:
    """The journal of the interrupted plot. Raises BadInput when it cannot be written, while the plot can still be resumed."""
    path = journal_path()
    try:
        journal = Journal.reopen(path)
    except OSError as error:
        raise BadInput(f"the journal {path} cannot be written ({error.strerror}): mend that, then `plotter resume`") from None
    with _told(journal):
        yield journal


@contextmanager
def _told(journal: Journal) -> Iterator[None]:
    """Its trouble, on every way out."""
    try:
        with journal:
            yield
    finally:
        if journal.trouble is not None:
            notes([journal.trouble])


def _without(path: Path, error: OSError, before: str | None) -> str:
    """What is said when no journal can be begun. A journal that stays would have another drawing drawn on this paper."""
    told = f"no journal can be written at {path} ({error.strerror}): this plot cannot be resumed if it is cut off"
    gone = discard(path)
    if before is None:
        return told
    if gone:
        return f"{told}; {before}, and can no longer be resumed either"
    return f"{told}; {before}, and its journal cannot be taken away: `plotter resume` would go on with that one on this paper"
