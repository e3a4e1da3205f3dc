"""Raw inertial logs on one clock, and orientations from them: gravity points up, and turns come out as they were."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body.orientation import FusionSettings, headings, northward, orientations, up_error, upright
from handtrack.errors import InputError
from handtrack.formats.imu_logs import GRAVITY, INERTIAL, MAGNETOMETER, TIME, ImuLogs, read_imu_logs, sensor_name

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "body_imu" / "Examples" / "logged_lower_body"
real_logs = pytest.mark.skipif(not REAL.is_dir(), reason="the recorded logs are not here")


def write_sensor(folder, step, count, start=0.0, lost=(), columns=INERTIAL, name="Inertial.csv", value=None):
    """A sensor whose columns hold the time, or `value(time)`; samples `lost` are left out."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [",".join([TIME, *columns])]
    for k in range(count):
        if k in lost:
            continue
        t = start + k * step
        cells = np.broadcast_to(t if value is None else value(t), len(columns))
        rows.append(",".join([f"{round(1e6 * t)}", *(f"{cell:.9g}" for cell in cells)]))
    (folder / name).write_text("\n".join(rows) + "\n")


def made_logs(gyroscope, accelerometer, rate=50.0, magnetometer=None):
    """Logs of one sensor."""
    m = gyroscope.shape[0]
    fields = np.full((m, 1, 3), np.nan) if magnetometer is None else magnetometer[:, None]
    return ImuLogs(
        ("one",), np.arange(m) / rate, gyroscope[:, None], accelerometer[:, None], fields, np.full((m, 1, 4), np.nan),
        np.ones((m, 1), dtype=bool), (m,),
    )  # fmt: skip


def test_sensors_of_unequal_rates_and_counts_come_onto_the_clock_that_all_share(tmp_path):
    write_sensor(tmp_path / "Left Foot 64F0EBCE (UDP)", 0.0200, 100, 10.00, lost=(40,))
    write_sensor(tmp_path / "pelvis", 0.0201, 95, 10.05)
    write_sensor(tmp_path / "Right Foot 64F0EBCF", 0.0199, 110, 9.99)
    logs = read_imu_logs(tmp_path)
    assert logs.names == ("left_foot", "pelvis", "right_foot") and logs.counts == (99, 95, 110)
    assert logs.time[0] == 0.0 and np.allclose(np.diff(logs.time), 0.02)
    assert logs.time[-1] <= 10.05 + 94 * 0.0201 - 10.05 and logs.time.size == 95
    # every column holds the time itself, which interpolation keeps
    expected = np.broadcast_to((10.05 + logs.time)[:, None, None], logs.gyroscope.shape)
    np.testing.assert_allclose(logs.gyroscope, np.radians(expected), rtol=1e-6)
    np.testing.assert_allclose(logs.accelerometer, GRAVITY * expected, rtol=1e-6)
    about = (np.abs(10.05 + logs.time - 10.80) < 0.02) & (np.abs(10.05 + logs.time - 10.80) > 1e-6)
    assert not logs.measured[about, 0].any() and logs.measured[:, 1:].all()
    assert np.isnan(logs.magnetometer).all() and np.isnan(logs.wxyz).all()


def test_a_wanted_rate_is_kept_and_quaternions_go_along_the_arc(tmp_path):
    write_sensor(tmp_path / "hip", 0.01, 201)
    quat = lambda t: Rotation.from_euler("z", t).as_quat(scalar_first=True)  # noqa: E731
    write_sensor(tmp_path / "hip", 0.05, 41, columns=("W", "X", "Y", "Z"), name="Quaternion.csv", value=quat)
    write_sensor(tmp_path / "hip", 0.05, 41, columns=MAGNETOMETER, name="Magnetometer.csv")
    logs = read_imu_logs(tmp_path, rate=40.0)
    assert logs.time.size == 81
    turned = Rotation.from_quat(logs.wxyz[:, 0], scalar_first=True).as_rotvec()[:, 2]
    np.testing.assert_allclose(turned, logs.time, atol=1e-6)
    np.testing.assert_allclose(logs.magnetometer[:, 0, 1], logs.time, atol=1e-6)


def test_a_long_gap_is_bridged_with_a_warning(tmp_path):
    write_sensor(tmp_path / "hip", 0.02, 100, lost=range(50, 70))
    assert "0.42 s pass without a sample" in read_imu_logs(tmp_path).warnings[0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "has no sensor"),
        (lambda path: write_sensor(path / "hip", 0.02, 1), "has 1 samples; 2 to"),
        (lambda path: write_sensor(path / "hip", 0.0, 3), "strictly rising"),
        (lambda path: write_sensor(path / "hip", 0.02, 9, columns=INERTIAL[:5]), "'Accelerometer Z .* is missing"),
        (
            lambda path: [write_sensor(path / f"hip 0000000{k}", 0.02, 9, columns=INERTIAL) for k in (1, 2)],
            "sensor 'hip' is there twice",
        ),
        (
            lambda path: [write_sensor(path / name, 0.02, 9, start) for name, start in (("a", 0.0), ("b", 5.0))],
            "no moment in common",
        ),
        (
            lambda path: [
                write_sensor(path / "hip", 0.02, 9),
                write_sensor(path / "hip", 0.02, 9, columns=("W", "X", "Y", "Z"), name="Quaternion.csv"),
            ],
            "a unit quaternion is wanted",
        ),
    ],
)
def test_what_are_no_logs_is_refused(tmp_path, make, message):
    make(tmp_path)
    with pytest.raises(InputError, match=message):
        read_imu_logs(tmp_path)


def test_a_missing_folder_and_bad_rates_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        read_imu_logs(tmp_path / "none")
    write_sensor(tmp_path / "hip", 0.02, 9)
    with pytest.raises(ValueError, match="rate: got 0"):
        read_imu_logs(tmp_path, rate=0.0)
    with pytest.raises(InputError, match="at most 5000000"):
        read_imu_logs(tmp_path, rate=1e9)


def test_serial_numbers_and_connections_are_no_part_of_a_sensors_name():
    assert sensor_name("Left Upper Leg 64F61CC4 (UDP)") == "left_upper_leg"
    assert sensor_name("pelvis") == "pelvis"


@real_logs
def test_seven_recorded_sensors_of_unequal_counts_share_one_clock():
    logs = read_imu_logs(REAL)
    assert len(logs.names) == 7 and min(logs.counts) < max(logs.counts)
    assert logs.time.size > 900 and np.isfinite(logs.accelerometer).all() and np.isfinite(logs.wxyz).all()
    assert 0.9 < logs.measured.mean() < 1.0


@real_logs
def test_gravity_points_up_and_tilts_agree_with_the_sensors_own_on_recorded_walking():
    pytest.importorskip("imufusion")
    logs = read_imu_logs(REAL)
    wxyz = orientations(logs)
    np.testing.assert_allclose(np.linalg.norm(wxyz, axis=-1), 1.0, atol=1e-5)
    assert np.degrees(up_error(logs, wxyz)).max() < 1.5
    up, own = (
        Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).inv().apply([0.0, 0.0, 1.0]) for q in (wxyz, logs.wxyz)
    )
    apart = np.degrees(np.arccos(np.clip((up * own).sum(axis=-1), -1.0, 1.0)))
    assert np.median(apart) < 1.0 and apart.max() < 6.0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_quarter_turn_about_any_axis_of_a_tilted_sensor_comes_out(axis):
    pytest.importorskip("imufusion")
    start = Rotation.from_euler("xyz", [20.0, -35.0, 0.0], degrees=True)
    steps = np.clip(np.arange(-20, 200) / 100.0, 0.0, 1.0) * math.radians(90.0)  # still at first, for the tilt
    world = Rotation.from_rotvec(steps[:, None] * np.eye(3)[axis]) * start
    rates = (world[:-1].inv() * world[1:]).as_rotvec() * 50.0
    gyroscope = np.concatenate([np.zeros((1, 3)), rates])
    logs = made_logs(gyroscope, world.inv().apply([0.0, 0.0, GRAVITY]))
    wxyz = orientations(logs)[:, 0]
    found = Rotation.from_quat(wxyz, scalar_first=True)
    turned = np.degrees((found[-1] * found[0].inv()).magnitude())
    assert turned == pytest.approx(90.0, abs=0.5)
    assert np.degrees(up_error(logs, wxyz[:, None]))[0] < 0.5


def test_headings_count_turns_on_without_jumps():
    pytest.importorskip("imufusion")
    rates = np.tile([0.0, 0.0, math.radians(180.0)], (300, 1))
    rates[0] = 0.0
    logs = made_logs(rates, np.tile([0.0, 0.0, GRAVITY], (300, 1)))
    turned = np.degrees(headings(orientations(logs))[:, 0])
    assert turned[-1] == pytest.approx(299 / 50 * 180.0, rel=1e-3)


def test_a_magnetic_field_holds_the_heading_that_a_biased_gyroscope_loses():
    pytest.importorskip("imufusion")
    rates = np.tile([0.0, 0.0, math.radians(2.0)], (1500, 1))  # a bias: the sensor does not turn
    still = np.tile([0.0, 0.0, GRAVITY], (1500, 1))
    logs = made_logs(rates, still, magnetometer=np.tile([0.3, 0.4, -0.5], (1500, 1)))
    lost = np.degrees(headings(orientations(logs)))[-1, 0]
    kept = np.degrees(headings(orientations(logs, FusionSettings(magnetic=True))))[-1, 0]
    assert lost == pytest.approx(60.0, abs=1.0) and abs(kept) < 6.0


def test_the_first_tilt_brings_up_to_the_vertical_even_upside_down():
    for up in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.3, -0.4, -0.8], [0.0, 0.0, -1.0]):
        n = np.array(up) / np.linalg.norm(up)
        turned = Rotation.from_quat(upright(np.array(up)), scalar_first=True).apply(n)
        np.testing.assert_allclose(turned, [0.0, 0.0, 1.0], atol=1e-9)
    north = Rotation.from_quat(
        northward(upright(np.array([0.3, -0.4, 0.8])), np.array([0.2, 0.5, 0.1])), scalar_first=True
    )
    assert north.apply([0.2, 0.5, 0.1])[1] == pytest.approx(0.0, abs=1e-12)


def test_without_the_library_or_a_magnetometer_the_reason_is_told(monkeypatch):
    logs = made_logs(np.zeros((4, 3)), np.tile([0.0, 0.0, GRAVITY], (4, 1)))
    with pytest.raises(ValueError, match="sensor 'one' has no magnetometer"):
        orientations(logs, FusionSettings(magnetic=True))
    monkeypatch.setitem(sys.modules, "imufusion", None)
    with pytest.raises(ValueError, match=r"pip install 'handtrack\[imu\]'"):
        orientations(logs)
    with pytest.raises(ValueError, match="gain: got -1"):
        replace(FusionSettings(), gain=-1.0)
