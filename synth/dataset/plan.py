"""How many images and how many to a unit in, the units of work out.

Unit k holds the images k s to min((k + 1) s, n) - 1, for n images and units of s. A unit is made, written and recorded
as a whole, by any worker, at any time: its bytes depend on nothing but its number and the job.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Unit:
    """Some images that follow each other.

    Attributes
    ----------
    number : int
    first, count : int
        Number of the first image in the dataset, and how many there are.
    """

    number: int
    first: int
    count: int

    @property
    def name(self) -> str:
        """What its files are called: five digits, more where they are needed."""
        return f"{self.number:05d}"


def unit_count(count: int, size: int) -> int:
    """Number of units.

    >>> unit_count(2001, 1000)
    3
    """
    return -(-count // size)


def units(count: int, size: int) -> tuple[Unit, ...]:
    """All units of `count` images, `size` to a unit.

    Raises
    ------
    ValueError
        If there are no images, or none to a unit.

    >>> [(unit.name, unit.first, unit.count) for unit in units(25, 10)]
    [('00000', 0, 10), ('00001', 10, 10), ('00002', 20, 5)]
    """
    if count < 1 or size < 1:
        raise ValueError(f"count, size: {count} images, {size} to a unit; at least 1 of each was wanted")
    return tuple(Unit(k, k * size, min(size, count - k * size)) for k in range(unit_count(count, size)))
