"""`handtrack reproduce`: the name of a published result in, theirs beside ours out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import InputError
from .console import progress, say, say_json, table
from .drift_walk import drift_walk
from .hri_tasks import hri_tasks
from .total_occlusion import total_occlusion
from .track import Residuals, Solver

app = typer.Typer(help="Published tables and figures, theirs beside ours.")

_Json = Annotated[bool, typer.Option("--json", help="JSON for machines.")]

_Plot = Annotated[Path | None, typer.Option(help="Picture to write beside the table: a .png, .svg or .pdf file.")]


@app.command("pose-tables")
def pose_tables(as_json: _Json = False, plot: _Plot = None) -> None:
    """Tables 3.1 to 3.6 of the hand thesis: iterates of Gauss-Newton on the R, P, PR and RR chains."""
    from ..reproduce import pose_tables as tables

    result = tables.pose_tables()
    if plot is not None:
        from .pictures import pose_figure, save

        save(pose_figure(result), plot)
    say((tables.as_json if as_json else tables.as_text)(result).rstrip())


@app.command("two-finger-occlusion")
def two_finger_occlusion(
    motions: Annotated[int, typer.Option(help="Number of seeded motions.")] = 20,
    variant: Annotated[
        Literal["crossing", "hard"],
        typer.Option(help="`hard`: perspective, noise 6, up to 8 degrees a frame, start wrong by 3 degrees."),
    ] = "crossing",
    residuals: Annotated[Residuals, typer.Option(help="Residuals of the pose estimation.")] = "outline",
    solver: Annotated[Solver, typer.Option(help="How a pose is found.")] = "levenberg-marquardt",
    first_seed: Annotated[int, typer.Option(help="Seed of the first motion; the others follow.")] = 0,
    frames: Annotated[int, typer.Option(help="Frames of each motion.")] = 60,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Section 6.1 of the hand thesis: the index finger crosses in front of the middle finger."""
    from .occlusion import as_data
    from .occlusion import two_finger_occlusion as run
    from .tracking import make_settings

    for name, value, least in (("motions", motions, 1), ("frames", frames, 2), ("first-seed", first_seed, 0)):
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")
    settings = make_settings({"residuals": residuals, "solver": solver})
    with progress("motions", motions) as done:
        result = run(motions, variant, settings, first_seed, frames, done)
    facts = as_data(result, variant, settings)
    if plot is not None:
        from .pictures import occlusion_figure, save

        save(occlusion_figure(result), plot)
    if as_json:
        say_json(facts)
        return
    header = ["motion", "worst joint", "RMSE deg", "lost", "NEES"]
    columns = zip(result.seed, result.worst_joint, result.worst_rmse, result.lost, result.nees, strict=True)
    say(table(header, [[int(s), j, float(r) * 57.29577951308232, int(n), float(e)] for s, j, r, n, e in columns]))
    say(
        f"\nworst joint's RMSE, median over {motions} motions: {facts['worst_rmse_median_deg']:.3f} deg, "
        f"largest {facts['worst_rmse_largest_deg']:.3f}; motions lost: {facts['motions_lost']}"
    )
    low, high = result.band
    say(
        f"NEES {facts['nees_mean']:.2f} for {facts['nees_dof']:.0f} degrees of freedom; in the 95 % band "
        f"{low:.2f} to {high:.2f} in {100 * result_share(facts):.0f} % of the frames"
    )


@app.command("edge-methods")
def edge_methods(
    motions: Annotated[int, typer.Option(help="Number of seeded motions of each scene.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Seed of the first motion; the others follow.")] = 0,
    frames: Annotated[int, typer.Option(help="Frames of each motion.")] = 60,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Appendix D of the hand thesis: every edge method on the same sequences, beside templates."""
    from .edge_methods import ROWS, VARIANTS, as_data, as_text, make_motions, run

    for name, value, least in (("motions", motions, 1), ("frames", frames, 2), ("first-seed", first_seed, 0)):
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")
    if plot is not None:  # first: a wrong name is told before minutes of work
        from .edge_pictures import criterion_figure
        from .pictures import save

        shown = min(5, frames - 1)
        save(criterion_figure(make_motions("crossing", 1, first_seed, shown + 1)[0], shown), plot)
    with progress("methods", len(VARIANTS) * ROWS) as done:
        results = run(motions, first_seed, frames, done)
    if as_json:
        say_json(as_data(results, motions))
    else:
        say(as_text(results, motions))


@app.command("full-hand")
def full_hand(
    motions: Annotated[int, typer.Option(help="Number of seeded motions.")] = 3,
    views: Annotated[int, typer.Option(help="Track with one camera, and beside it with this many.")] = 2,
    first_seed: Annotated[int, typer.Option(help="Seed of the first motion; the others follow.")] = 0,
    frames: Annotated[int, typer.Option(help="Frames of each motion.")] = 60,
    refine: Annotated[bool, typer.Option("--refine", help="Edges and grey levels in one solve.")] = False,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Section 6.2.2 of the hand thesis: 21 joints, spreading and graded flexion, tilted by 45 degrees."""
    from ..reproduce.full_hand import as_data, rows, summary
    from ..settings import Settings
    from .full_hand import figure, track_hands

    for name, value, least in (("motions", motions, 1), ("frames", frames, 3), ("first-seed", first_seed, 0)):
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")
    if not 1 <= views <= 5:
        raise InputError(f"--views: {views} given; 1 to 5 was wanted")
    results = []
    for count in sorted({1, views}):
        with progress(f"motions, {count} view{'s' if count > 1 else ''}", motions) as done:
            results.append(track_hands(motions, count, Settings(refine=refine), first_seed, frames, done))
    if plot is not None:
        from .pictures import save

        save(figure(results), plot)
    if as_json:
        say_json(as_data(results))
        return
    say(table(*rows(results)))
    for result in results:
        say("\n" + "\n".join(summary(result)))


@app.command("assembly-occlusion")
def assembly_occlusion(
    cycles: Annotated[int, typer.Option(help="Number of seeded cycles of each kind of occlusion.")] = 25,
    occlusion: Annotated[
        Literal["static", "dynamic", "both"],
        typer.Option(help="Behind a shelf, behind a moving robot's link, or both."),
    ] = "both",
    first_seed: Annotated[int, typer.Option(help="Seed of the first cell; the others follow.")] = 0,
    frames: Annotated[int, typer.Option(help="Frames of each cycle; 300 are a whole one.")] = 300,
    particles: Annotated[int | None, typer.Option(help="Particles of the wrist.", show_default="2000")] = None,
    narrow: Annotated[
        float | None,
        typer.Option(help="Another half-thickness of the joint volume for `complete`, degrees.", show_default=False),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")] = None,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Section 7.3 of the wrist thesis: a wrist hidden by shelf and robot, three variants of the filter."""
    from synth.cell import CellSettings

    from ..reproduce.assembly_occlusion import HEADER, as_data, table_rows
    from .assembly import KINDS, assembly_occlusion, figure, variants
    from .pictures import check, save

    least_of = (("cycles", cycles, 1), ("frames", frames, 2), ("first-seed", first_seed, 0))
    for name, value, least in least_of:
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")
    if narrow is not None and not 0.0 < narrow <= 90.0:
        raise InputError(f"--narrow: {narrow:g} given; degrees above 0, at most 90, were wanted")
    if plot is not None:  # first: a wrong name is told before minutes of work
        check(plot)
    kinds = KINDS if occlusion == "both" else (occlusion,)
    named = variants(particles, narrow)
    with progress("cells", cycles * len(kinds)) as done:
        results = assembly_occlusion(cycles, named, CellSettings(frames=frames), first_seed, kinds, workers, done)
    if plot is not None:
        save(figure(results), plot)
    if as_json:
        say_json(as_data(results))
        return
    for result in results:
        say(f"{result.kind} occlusion, {result.cycles} cycles, {result.hidden} hidden frames")
        say(table(HEADER, table_rows(result)) + "\n")
    say("theirs: section 7.3.3, errors behind a shelf; 'one order' of magnitude in words only; recovery in frames")


app.command("hri-tasks")(hri_tasks)
app.command("drift-walk")(drift_walk)
app.command("total-occlusion")(total_occlusion)


def result_share(facts: dict[str, object]) -> float:
    """Share of frames inside the band."""
    return float(facts["nees_frames_in_band"])  # type: ignore[arg-type]
