"""A JSON file and its schema in, checked content out.

As for the other text files: a limit on size, numbers that are finite, and one line that names file, place and what was
wanted. Keys that the schema does not know are left alone: these are other programs' files.
"""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import InputError
from .paths import read_bytes

MOST_BYTES = 200_000_000

ModelT = TypeVar("ModelT", bound=BaseModel)


class Loose(BaseModel):
    """Base of the schema of another program's JSON: finite numbers; unknown keys are left alone."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


def read_json(path: Path, schema: type[ModelT], wanted: str) -> ModelT:
    """Content of a JSON file.

    Parameters
    ----------
    wanted : str
        What the file should be, for the error's line.

    Raises
    ------
    InputError
        If it is no file, too large, no JSON, or not what the schema asks for.
    """
    data = read_bytes(path, MOST_BYTES)
    try:
        return schema.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])[:100]
        reason = " ".join(first["msg"].split())[:200]
        raise InputError(f"{path}: {f'{place}: ' if place else ''}{reason}; {wanted} is wanted") from error
