"""Images done in, a bar with rate and time left on stderr out; without a terminal, a line now and then."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .console import note

SECONDS = 30.0  # between lines where stderr is no terminal

Done = Callable[[int, int], None]  # images done, and how many of them were before this run


@contextmanager
def image_progress(label: str, total: int) -> Iterator[Done]:
    """Tell how far a run is while the block runs."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
    begun = told = time.monotonic()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=total, rate="")

        def update(done: int, before: int, /) -> None:
            nonlocal told
            now = time.monotonic()
            words = rate_words(done - before, total - done, now - begun)
            bar.update(task, completed=done, rate=words)
            if not console.is_terminal and now - told >= SECONDS:
                told = now
                note(f"{label}: {done} of {total}, {words}")

        yield update


def rate_words(made: int, left: int, seconds: float) -> str:
    """Rate and time left.

    >>> rate_words(500, 1500, 10.0), rate_words(0, 10, 1.0)
    ('50.0 images/s, 30 s left', '')
    """
    if made < 1 or seconds <= 0:
        return ""
    rate = made / seconds
    return f"{rate:.1f} images/s, {time_words(left / rate)} left"


def time_words(seconds: float) -> str:
    """A stretch of time in the two largest units that it needs.

    >>> time_words(59.0), time_words(61.0), time_words(7325.0)
    ('59 s', '1 min 1 s', '2 h 2 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
