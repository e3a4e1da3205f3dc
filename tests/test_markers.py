"""Marker files: known facts of real recordings, units, gaps, and one clear line for what is malformed."""

from pathlib import Path

import numpy as np
import pytest

from handtrack.errors import InputError
from handtrack.formats.markers import read_markers

DATA = Path(__file__).parents[2] / "shared" / "data"
TSV = "NO_OF_FRAMES\t2\nFREQUENCY\t50\nMARKER_NAMES\ta\tb\n{columns}1\t2\t3\t4\t5\t6\n0\t0\t0\t7\t8\t9\n"
TRC = (
    "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n60\t60\t2\t2\tm\n"
    "Frame#\tTime\tone\t\t\ttwo\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
    "1\t0.0\t1\t2\t3\t4\t5\t6\n2\t0.016\t\t\t\t7\t8\t9\n"
)


def test_the_hand_recording_has_its_markers_and_gaps():
    markers = read_markers(DATA / "hand_mocap" / "recording.tsv")
    assert markers.places.shape == (6000, 21, 3) and markers.rate == 100.0
    gaps = np.isnan(markers.places[..., 0]).mean(axis=0) * 100
    found = dict(zip(markers.names, gaps.round(1), strict=True))
    assert (found["thumb_tip"], found["middle_tip"], found["ring_tip"]) == (8.2, 1.3, 0.7)
    assert np.count_nonzero(gaps) == 3


def test_the_body_recording_has_its_markers():
    markers = read_markers(DATA / "body_markers" / "markers.trc")
    assert len(markers.names) == 51 and markers.rate == 100.0 and not np.isnan(markers.places).any()


@pytest.mark.parametrize("columns", ["", "Frame\tTime\ta X\ta Y\ta Z\tb X\tb Y\tb Z\n"])
def test_a_marker_of_zeros_was_not_seen(tmp_path, columns):
    text = TSV.format(columns=columns)
    if columns:
        text = text.replace("1\t2\t3", "1\t0.0\t1\t2\t3").replace("0\t0\t0\t7", "2\t0.02\t0\t0\t0\t7")
    path = tmp_path / "m.tsv"
    path.write_text(text)
    markers = read_markers(path)
    assert markers.names == ("a", "b") and markers.rate == 50.0
    np.testing.assert_array_equal(markers.places, [[[1, 2, 3], [4, 5, 6]], [[np.nan] * 3, [7, 8, 9]]])


@pytest.mark.parametrize("cut", ["\t", ","])
def test_trc_lengths_become_millimetres_and_empty_cells_gaps(tmp_path, cut):
    path = tmp_path / "m.trc"
    path.write_text(TRC.replace("\t", cut))
    markers = read_markers(path)
    assert markers.names == ("one", "two") and markers.rate == 60.0
    np.testing.assert_array_equal(markers.places[0], [[1000, 2000, 3000], [4000, 5000, 6000]])
    assert np.isnan(markers.places[1, 0]).all()


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("m.csv", "a", r"ending '.csv'; .tsv \(Qualisys\) or .trc is wanted"),
        ("m.tsv", "hello\n1\t2", "lacks MARKER_NAMES or FREQUENCY"),
        ("m.tsv", TSV.format(columns="").replace("a\tb", "a\ta"), "marker 'a' is given twice"),
        (
            "m.tsv",
            TSV.format(columns="").replace("5", "five", 2).replace("fiveo", "50"),
            "FREQUENCY|numbers are wanted",
        ),
        ("m.tsv", TSV.format(columns="").replace("\t5\t", "\tx\t"), "line 4: .* numbers are wanted"),
        ("m.tsv", TSV.format(columns="").replace("\t5\t", "\tinf\t"), "line 4: holds an infinite number"),
        ("m.trc", "x\n" * 8, "PathFileType is wanted"),
        ("m.trc", TRC.replace("\tm\n", "\tfeet\n"), "Units out of mm, cm, m"),
        ("m.trc", TRC.replace("one", "").replace("two", ""), "holds no marker names"),
        ("m.trc", TRC[: TRC.index("1\t0.0")] + "\n\n", "no rows of places"),
    ],
)
def test_what_is_malformed_is_named(tmp_path, name, text, wanted):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=wanted):
        read_markers(path)
