"""Arguments in, exit code out: 0 done, 1 failed on the way, 2 bad input or arguments, 130 interrupted.

A failure is one `error:` line on stderr, what is accepted with care a `warning:` line; `--debug` adds the traceback.
The command modules import their work when they run, so that `handtrack --help` does not wait for compilers and plots.
"""

import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Annotated

import typer

from ..errors import InputError
from . import bench, benchmark, body, calibrate, dataset, demo, evaluate, explain, models, render, reproduce, track
from .console import error, say, version_of, warning

INTERRUPTED = 130
# Matrices are small here: threads that wait for each other cost milliseconds a frame where a core is busy.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

app = typer.Typer(
    name="handtrack",
    help="Track fingers in images and video with articulated pill models, and say how sure each pose is.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command()(demo.demo)
app.command()(track.track)
app.command()(evaluate.evaluate)
app.command()(explain.explain)
app.command()(calibrate.calibrate_shape)
app.command()(render.render)
app.add_typer(dataset.app, name="dataset")
app.add_typer(reproduce.app, name="reproduce")
app.add_typer(benchmark.app, name="benchmark")
app.add_typer(models.app, name="models")
app.add_typer(body.app, name="body")
app.command()(bench.bench)

# What typer raises for wrong arguments; reached this way because some versions bring their own copy of click.
_UsageError = typer.BadParameter.__mro__[2]


def _show_version(wanted: bool) -> bool:
    if wanted:
        say(f"handtrack {version_of('handtrack')}")
        raise typer.Exit
    return wanted


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of a failure.")] = False,
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; `arguments` without the program's name, those of the process if None. Returns the exit code."""
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given
    given = [argument for argument in given if argument != "--debug"]
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _show_warning
        try:
            code = _run(given or ["--help"])
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except Exception as failure:  # noqa: BLE001 - the last stop: every failure becomes one line and an exit code
            if debug:
                traceback.print_exc()
            code = _explain(failure)
    if code == INTERRUPTED:  # some versions of typer return it, some raise
        error("interrupted")
    return code


def _run(arguments: list[str]) -> int:
    code = app(arguments, prog_name="handtrack", standalone_mode=False)
    return code if isinstance(code, int) else 0


def _explain(failure: Exception) -> int:
    """Print the line that a failure deserves and return its exit code."""
    if isinstance(failure, InputError):
        error(str(failure))
        return 2
    if isinstance(failure, _UsageError):
        message = getattr(failure, "format_message", failure.__str__)()
        error(f"{message.rstrip('.')} (see --help)")
        return 2
    if isinstance(failure, OSError) and failure.strerror:
        place = f"{failure.filename}: " if failure.filename else ""
        error(f"{place}{failure.strerror}")
        return 1
    error(f"{type(failure).__name__}: {failure} (--debug shows where)")
    return 1


def _show_warning(message: Warning | str, category: type[Warning], *place: object, **more: object) -> None:
    warning(str(message))
