"""Settings: what is allowed, and one clear line for everything else."""

import math
from dataclasses import FrozenInstanceError, fields
from typing import Any, get_args

import pytest
from jaxtyping import config

from handtrack.settings import Settings

CHOICES = {field.name: get_args(field.type) for field in fields(Settings) if get_args(field.type)}


@pytest.mark.parametrize(("name", "choice"), [(name, choice) for name, all_ in CHOICES.items() for choice in all_])
def test_every_choice_in_the_annotation_is_accepted(name, choice):
    # Templates of the first frame are whole-link profiles, which only the line residuals use.
    choices: dict[str, Any] = {"residuals": "lines"} if choice == "first" else {}
    choices[name] = choice
    assert getattr(Settings(**choices), name) == choice


def test_templates_of_the_first_frame_are_refused_for_outlines():
    with pytest.raises(ValueError, match="templates: got 'first'"):
        Settings(templates="first")


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("wrong", ["", "OUTLINE", "rays ", "best"])
def test_an_unknown_choice_is_refused_with_the_known_ones(monkeypatch, name, wrong):
    # The type checker of the tests would be first; users run without it.
    monkeypatch.setattr(config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=f"^{name}: got '{wrong}', wanted one of {', '.join(CHOICES[name])}$"):
        Settings(**{name: wrong})


@pytest.mark.parametrize(
    ("name", "wrong", "wanted"),
    [
        ("passes", 0, "1 to 20"),
        ("passes", 21, "1 to 20"),
        ("theta", 0.0, "a number between 0 and 1"),
        ("theta", 1.0, "a number between 0 and 1"),
        ("theta", math.nan, "a number between 0 and 1"),
    ]
    + [
        (name, wrong, "a positive number")
        for name in ("start_sigma", "start_speed", "spacing")
        for wrong in (0.0, -1.0, math.inf, math.nan)
    ],
)
def test_a_number_out_of_range_is_refused(name, wrong, wanted):
    with pytest.raises(ValueError, match=f"^{name}: got {wrong}, wanted {wanted}$"):
        Settings(**{name: wrong})


@pytest.mark.parametrize(("name", "value"), [("passes", 1), ("passes", 20), ("theta", 0.01), ("spacing", 1e-3)])
def test_the_ends_of_the_ranges_are_accepted(name, value):
    assert getattr(Settings(**{name: value}), name) == value


def test_the_defaults_are_the_outline_against_rendered_templates():
    chosen = Settings()
    assert (chosen.residuals, chosen.templates, chosen.visibility) == ("outline", "rendered", "rays")
    assert (chosen.solver, chosen.filter, chosen.interpolation) == ("levenberg-marquardt", "kalman", "bilinear")


def test_settings_do_not_change():
    with pytest.raises(FrozenInstanceError):
        Settings().passes = 3  # pyright: ignore[reportAttributeAccessIssue]
