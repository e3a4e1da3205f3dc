"""Messages in, lines on the terminal out: results on stdout, everything else on stderr."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata

import typer

Done = Callable[[int], None]  # told how many steps are done


def say(text: str = "") -> None:
    """A line of the result."""
    typer.echo(text)


def note(text: str) -> None:
    """A line about the work, on stderr."""
    typer.echo(text, err=True)


def warning(text: str) -> None:
    """What was accepted with care."""
    typer.echo(f"warning: {_one_line(text)}", err=True)


def error(text: str) -> None:
    """Why the command failed."""
    typer.echo(f"error: {_one_line(text)}", err=True)


def say_json(value: object) -> None:
    """JSON for machines; what is not finite becomes null."""
    typer.echo(json.dumps(finite(value), indent=2, ensure_ascii=False))


def finite(value: object) -> object:
    """The value as plain JSON data: arrays as lists, NaN and infinity as None.

    >>> finite({"a": (1.5, float("nan"))})
    {'a': [1.5, None]}
    """
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return finite(value.tolist())  # type: ignore[attr-defined]
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Columns lined up, numbers to the right.

    >>> table(["joint", "rmse"], [["pip", 0.25], ["mcp", 12.0]]).splitlines()
    ['joint   rmse', 'pip     0.25', 'mcp    12.00']
    """
    cells = [[_cell(item) for item in row] for row in rows]
    left = [all(isinstance(row[i], str) for row in rows) for i in range(len(header))]
    widths = [max(len(line[i]) for line in [list(header), *cells]) for i in range(len(header))]
    lines = []
    for line in [list(header), *cells]:
        aligned = [
            text.ljust(w) if to_left else text.rjust(w) for text, w, to_left in zip(line, widths, left, strict=True)
        ]
        lines.append("  ".join(aligned).rstrip())
    return "\n".join(lines)


@contextmanager
def progress(label: str, total: int | None) -> Iterator[Done]:
    """A bar on stderr while the block runs; silent where stderr is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=total)

        def update(done: int, /) -> None:
            bar.update(task, completed=done)

        yield update


def version_of(package: str) -> str:
    """Version of an installed package; a package run from its source tree has none."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _cell(item: object) -> str:
    if isinstance(item, float):
        return "-" if math.isnan(item) else f"{item:.2f}"
    return str(item)


def _one_line(text: str) -> str:
    return " ".join(text.split())
