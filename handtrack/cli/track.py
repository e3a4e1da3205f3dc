"""`handtrack track`: a sequence, image folders or videos in, a run folder out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import say, say_json

Residuals = Literal["outline", "lines"]
Edges = Literal["wssd", "difference", "gaussian", "width", "width-compensated", "plls", "mwplls", "mwplls-iterative"]
Solver = Literal["levenberg-marquardt", "gauss-newton", "gauss-newton-one", "damped", "trust-region"]


def track(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT...",
            help="Folder with sequence.yaml; or a folder of images or a video for each view.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier run there is replaced.", show_default=False)],
    model: Annotated[
        str | None, typer.Option(help="Built-in model or model file; for images and videos, or instead.")
    ] = None,
    camera: Annotated[
        list[Path] | None,
        typer.Option(help="File with `camera: {...}`, for images and videos; once for each view, in their order."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Pose of the first frame in degrees: a file with `start: {...}`, or '{joint: value, ...}'."),
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second, for a folder of images.")] = None,
    surface: Annotated[
        Path | None, typer.Option(help="Skinned hand mesh (.glb, W3C joint names) to track with instead of pills.")
    ] = None,
    calibrate: Annotated[
        int | None,
        typer.Option(
            metavar="FRAMES",
            help="First find the shape of the links from so many frames (20 is usual).",
            show_default=False,
        ),
    ] = None,
    residuals: Annotated[
        Residuals, typer.Option(help="Edge points against the outline, or the thesis's lines.")
    ] = "outline",
    edges: Annotated[
        Edges, typer.Option(help="How edges are found: against expected profiles, or as in the thesis's appendix D.")
    ] = "wssd",
    refine: Annotated[
        bool, typer.Option("--refine", help="Align with the grey levels of the surface too: slower, more accurate.")
    ] = False,
    hypotheses: Annotated[
        bool, typer.Option(help="Keep the other side of a link that may be folded either way, until images decide.")
    ] = True,
    solver: Annotated[Solver, typer.Option(help="How a pose is found.")] = "levenberg-marquardt",
    templates: Annotated[Literal["rendered", "first"], typer.Option(help="Where templates come from.")] = "rendered",
    visibility: Annotated[Literal["rays", "polygons"], typer.Option(help="How hidden samples are found.")] = "rays",
    interpolation: Annotated[
        Literal["nearest", "bilinear", "bicubic"], typer.Option(help="How profiles are sampled.")
    ] = "bilinear",
    filter_: Annotated[
        Literal["kalman", "ghk", "none"], typer.Option("--filter", help="How the next frame is predicted.")
    ] = "kalman",
    theta: Annotated[
        float | None, typer.Option(help="Discounting factor of the g-h-k filter, between 0 and 1.")
    ] = None,
    passes: Annotated[int | None, typer.Option(help="Most measuring passes on a frame.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Follow a model through the images; writes poses, covariance, overlay video and an HTML report."""
    from .tracking import make_settings, open_input, summary, summary_text, track_into

    chosen = {
        "residuals": residuals,
        "edges": edges,
        "refine": refine,
        "hypotheses": hypotheses,
        "solver": solver,
        "templates": templates,
        "visibility": visibility,
        "interpolation": interpolation,
        "filter": filter_,
        "theta": theta,
        "passes": passes,
    }
    settings = make_settings({name: value for name, value in chosen.items() if value is not None})
    sequence = open_input(sources, model, camera or [], start, fps)
    result = track_into(out, sequence, settings, surface, calibrate)
    if as_json:
        say_json(summary(result, out))
    else:
        say(summary_text(result, out))
