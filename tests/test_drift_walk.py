"""Claims about the walks that are held against what the walk paper says of its own."""

import numpy as np
import pytest

from handtrack.reproduce.drift_walk import (
    CLAIM_HEADER,
    LAP_HEADER,
    MORE_HEADER,
    NAMES,
    Trial,
    as_data,
    average,
    claim_rows,
    claims,
    comparison,
    growth,
    lap_rows,
    more_rows,
)

METHODS = tuple(NAMES)
LEVEL = np.array([0.04, 0.06, 0.09, 0.03, 0.2, 0.1])  # of each method, metres
RELATIVE = np.array([0.05, 0.05, 0.052, 0.05, 0.1, 0.04])
F = 45


def trial(laps=4.5, scale=1.0, grow=1.0, seen=True):
    """Errors that stay as they are, but for the suit's, which is `1 + grow * lap` times as large."""
    lap = np.linspace(0.0, laps, F)
    wave = 1.0 + 0.1 * np.where(np.arange(F) % 2, 1.0, -1.0)
    place = scale * LEVEL[:, None] * np.tile(wave, (len(METHODS), 1))
    place[-1] *= 1.0 + grow * np.floor(lap)
    return Trial(
        lap=lap, in_view=np.full(F, True) if seen else np.arange(F) % 3 > 0, place=place,
        heading=np.full((6, F), 0.01), hand=place + 0.02, relative=np.tile(RELATIVE[:, None], F),
        held=np.full(6, 0.95), milliseconds=np.arange(6.0),
    )  # fmt: skip


def test_the_last_whole_lap_is_held_against_the_first():
    result = comparison(METHODS, [trial(), trial(scale=2.0)])
    assert result.walks == 2 and result.quartiles.shape == (6, 4, 3) and result.lap_means.shape == (2, 6, 4)
    ratio = growth(result)
    assert np.allclose(ratio[:, :-1], 1.0, atol=0.05) and np.allclose(ratio[:, -1], 4.0, atol=0.1)
    assert result.worst[0] == pytest.approx(0.08, rel=0.02) and result.means[0, 0] == pytest.approx(0.04, rel=0.02)


def test_a_walk_of_fewer_laps_ends_where_it_ends():
    result = comparison(METHODS, [trial(4.5), trial(2.5)])
    assert np.isnan(result.lap_means[1, :, 2:]).all() and np.isfinite(result.lap_means[0]).all()
    assert growth(result)[1, -1] == pytest.approx(2.0, abs=0.05)
    cells = dict(zip(LAP_HEADER, lap_rows(result)[-1], strict=True))
    assert 195 <= float(str(cells["last lap"])) <= 205, "the last lap that both walked"


def test_less_than_a_lap_counts_as_one():
    result = comparison(METHODS, [trial(0.7)])
    assert result.lap_means.shape == (1, 6, 1) and np.allclose(growth(result), 1.0)
    assert result.lap_means[0, 0, 0] == pytest.approx(0.04, rel=0.02)


def test_quartiles_are_over_the_frames_of_all_walks():
    result = comparison(METHODS, [trial(), trial(scale=3.0)])
    low, middle, high = result.quartiles[0, 0]
    assert 0.036 <= low <= 0.044 and low < middle < high and 0.108 <= high <= 0.132


def test_a_person_who_is_always_seen_has_no_error_out_of_view():
    assert np.isnan(comparison(METHODS, [trial()]).blind).all()
    result = comparison(METHODS, [trial(), trial(seen=False)])
    assert np.isfinite(result.blind[1]).all() and average(result.blind[:, 0]) == pytest.approx(0.04, rel=0.1)
    assert lap_rows(comparison(METHODS, [trial()]))[0][-1] == "-" and np.isnan(average(np.full(2, np.nan)))


def test_rows_have_a_cell_for_every_head():
    result = comparison(METHODS, [trial(seen=False)])
    for header, rows in ((LAP_HEADER, lap_rows(result)), (MORE_HEADER, more_rows(result))):
        assert {len(row) for row in rows} == {len(header)} and [row[0] for row in rows] == list(NAMES.values())
    assert {len(row) for row in claim_rows(result)} == {len(CLAIM_HEADER)}
    assert more_rows(result)[1][1:] == ["0.57", "95", "80", "50", "1.00"]


def test_what_the_paper_says_holds_where_the_drift_grows_and_not_where_it_does_not():
    held = [claim.holds for claim in claims(comparison(METHODS, [trial(), trial(scale=1.2)]))]
    assert held == [True] * 7
    still = claims(comparison(METHODS, [trial(grow=0.0)]))
    assert [claim.holds for claim in still[:3]] == [True, False, False]
    worse = trial()
    worse.place[0] = 1.0
    worse.hand[0] = 1.0
    found = claims(comparison(METHODS, [worse]))
    assert not found[0].holds and "best in 0 of 1" in found[0].ours and not found[3].holds and not found[6].holds


def test_without_the_methods_of_the_paper_nothing_is_held_against_it():
    one = trial()
    some = Trial(
        one.lap, one.in_view, one.place[3:], one.heading[3:], one.hand[3:], one.relative[3:], one.held[3:],
        one.milliseconds[3:],
    )  # fmt: skip
    assert claims(comparison(METHODS[3:], [some])) == []
    with pytest.raises(ValueError, match="at least one"):
        comparison(METHODS, [])


def test_data_hold_a_figure_of_every_method_and_what_the_paper_says():
    data = as_data(comparison(METHODS, [trial(seen=False)] * 3))
    assert data["walks"] == 3 and data["figures"] == ["3", "5"]
    methods, paper = data["methods"], data["paper"]
    assert isinstance(methods, list) and isinstance(paper, list)
    assert [entry["method"] for entry in methods] == list(METHODS) and len(paper) == 7
    assert methods[3]["mean_m"] == pytest.approx(0.03, rel=0.02) and methods[0]["heading_deg"] == pytest.approx(
        0.573, 0.01
    )
    assert len(methods[0]["lap_means_m"]) == 4 and methods[5]["last_lap_over_first"][0] == pytest.approx(4.0, abs=0.1)
