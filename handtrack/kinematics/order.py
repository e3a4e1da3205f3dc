"""Rows of a table in any order in, rows with parents before children out; refuses what is not a tree."""

from collections.abc import Sequence
from typing import Protocol, TypeVar, runtime_checkable


@runtime_checkable
class _Row(Protocol):
    @property
    def id(self) -> int: ...
    @property
    def parent(self) -> int: ...


RowT = TypeVar("RowT", bound=_Row)


def parents_first(rows: Sequence[RowT]) -> list[RowT]:
    """Order rows so that every parent comes before its children; the order of the file is kept otherwise.

    Raises
    ------
    ValueError
        For an id that is not positive or is given twice, a parent that does not exist, or a cycle.
    """
    ids = [row.id for row in rows]
    for row in rows:
        if row.id < 1:
            raise ValueError(f"frame {row.id}: id must be a positive integer (0 is the base frame)")
        if ids.count(row.id) > 1:
            raise ValueError(f"frame {row.id}: id is given twice; ids are unique")
        if row.parent != 0 and row.parent not in ids:
            raise ValueError(f"frame {row.id}: parent {row.parent} does not exist")
    placed: set[int] = {0}
    ordered: list[RowT] = []
    waiting = list(rows)
    while waiting:
        ready = next((row for row in waiting if row.parent in placed), None)
        if ready is None:
            raise ValueError(f"frame {waiting[0].id}: its parents form a cycle that never reaches the base frame 0")
        ordered.append(ready)
        placed.add(ready.id)
        waiting.remove(ready)
    return ordered
