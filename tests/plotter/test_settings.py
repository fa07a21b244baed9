"""Settings: bounds where they are read, origins, and refusals that name the value."""

import re
from pathlib import Path

import numpy as np
import pytest

from plotter import units
from plotter.errors import BadInput
from plotter.machines.profile import load_machine, load_pen_lift, machine_names
from plotter.settings import Settings, resolve

ALMOST = 1e-12


@pytest.mark.parametrize(
    ("text", "millimetres"),
    [("10mm", 10), ("1in", 25.4), ("2.5", 2.5), ("1cm", 10), ("72pt", 25.4), ("96px", 25.4), ("-3 mm", -3), (".5mm", 0.5)],
)
def test_lengths_carry_units(text: str, millimetres: float) -> None:
    assert units.length_mm(text) == pytest.approx(millimetres, abs=ALMOST)


@pytest.mark.parametrize("text", ["", "mm", "10 parsecs", "1e999", "nan", "10mm/s", "1,5mm"])
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not a"):
        units.length_mm(text)


def test_speeds_and_times() -> None:
    assert units.speed_mm_s("3in/s") == pytest.approx(76.2)
    assert units.acceleration_mm_s2("1m/s2") == 1000
    assert units.jerk_mm_s3("50m/s3") == 50_000
    assert units.time_s("200ms") == pytest.approx(0.2)
    assert units.percent("60%") == 60


@pytest.mark.parametrize(("seconds", "text"), [(8.44, "8.4 s"), (185, "3 min 05 s"), (3720, "1 h 02 min"), (59.96, "60.0 s")])
def test_spoken_durations(seconds: float, text: str) -> None:
    assert units.spoken_duration(seconds) == text


def test_a_flag_overrides_the_file_and_the_file_the_quality(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('draw_speed = "60mm/s"\ntravel_speed = 120\nquality = "draft"\n')
    resolved = resolve({"draw_speed": "70"}, file)
    assert resolved.values.draw_speed == 70
    assert resolved.origin["draw_speed"] == "flag"
    assert resolved.values.travel_speed == 120
    assert str(file) in resolved.origin["travel_speed"]
    assert resolved.origin["draw_jerk"] == "quality draft"
    assert resolved.origin["seed"] == "default"


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        ({"draw_speed": "5000"}, "--draw-speed 5000 must be at most 1000 mm/s; see"),
        ({"draw_speed": "0"}, "must be more than 0 mm/s"),
        ({"draw_jerk": "0"}, "must be more than 0 mm/s3"),
        ({"tolerance": "1mm"}, "--tolerance 1mm must be at most 0.2 mm"),
        ({"max_stroke": "0"}, "--max-stroke 0 must be more than 0 mm"),
        ({"dot_dwell": "2min"}, "--dot-dwell 2min must be at most 60 s"),
        ({"lead": "2"}, "--lead 2 must be at most 1.2 s"),
        ({"pen_up": "120"}, "--pen-up 120 must be at most 100 %"),
        ({"overlap": "2"}, "--overlap 2 must be at most 1;"),
        ({"draw_speed": "fast"}, "--draw-speed fast is refused: 'fast' is not a number with one of the units mm/s"),
        ({"dip": "1s"}, "--dip 1s is for re-inking: give --reink-every and --well with it"),
        ({"dip": "1s", "reink_every": "2m"}, "--dip 1s is for re-inking: give --well with it"),
        ({"well": "1,2"}, "--well (1,2) needs --reink-every"),
        ({"drwa_speed": "50"}, "no setting 'drwa_speed'"),
        ({"machine": "axidraw-v9"}, "axidraw-v9"),
        ({"quality": "best"}, "quality 'best'"),
        ({"pen_up": "30", "pen_down": "60"}, "--pen-up (30 %) must be above --pen-down (60 %)"),
        ({"draw_speed": "inf"}, "--draw-speed"),
    ],
)
def test_what_is_out_of_bounds_is_refused_by_name(flags: dict[str, str], part: str, tmp_path: Path) -> None:
    empty = tmp_path / "settings.toml"
    empty.write_text("")
    with pytest.raises(BadInput) as refusal:
        resolve(flags, empty)
    assert part in str(refusal.value)


def test_what_is_out_of_bounds_in_the_file_is_named_with_it(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("draw_speed = 5000\ndip = 1\n")  # a dip of one's own is there for when there is a well
    with pytest.raises(BadInput) as refusal:
        resolve({}, file)
    assert str(refusal.value).startswith(f"settings file {file}: draw_speed = 5000 must be at most 1000 mm/s; see ")
    assert resolve({"draw_speed": "50"}, file).values.dip == 1


def test_an_unknown_key_in_the_file_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("dpi = 3\n")
    with pytest.raises(BadInput, match="no setting 'dpi'"):
        resolve({}, file)


@pytest.mark.parametrize("content", [b"draw_speed = ", b"\xff\xfe\x00"])
def test_a_file_that_is_not_toml_is_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_bytes(content)
    with pytest.raises(BadInput, match="not TOML"):
        resolve({}, file)


def test_a_missing_settings_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot read"):
        resolve({}, tmp_path / "none.toml")


@pytest.mark.parametrize("name", machine_names())
def test_every_machine_profile_loads_with_its_pen_lift(name: str) -> None:
    machine = load_machine(name)
    lift = load_pen_lift(machine.pen_lift)
    assert machine.kinematics().max_speed_any_direction_mm_s > 100
    assert lift.up_pulse > lift.down_pulse
    assert 0.05 < lift.lift_s() < 0.5
    assert 0.05 < lift.lower_s() < 0.5


OWN = """
title = "mine"
board = "ebb"
width_mm = 420.0
height_mm = 297.0
steps_per_mm = [[160.0, 0.0], [0.0, 160.0]]
max_step_rate = 24900.0
pen_lift = "brushless"
"""


def test_a_machine_of_ones_own_is_a_file_that_is_found_again_from_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.toml").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    values = resolve({"machine": "mine.toml"}).values
    monkeypatch.chdir("/")
    machine = values.machine_profile()
    assert (machine.width_mm, machine.title) == (420.0, "mine")
    assert values.pen_lift().title == load_pen_lift("brushless").title
    assert machine.kinematics().steps(np.array([[1.0, 2.0]])).tolist() == [[160.0, 320.0]]


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (("width_mm = 420.0", "width_mm = -1.0"), "width_mm = -1.0 must be more than 0"),
        (("24900.0", "60000.0"), "max_step_rate = 60000.0 must be at most 25000"),
        (('"mine"', '"mine"\ncolour = 3'), "there is no setting 'colour'"),
        (("title =", "titel ="), "title is missing"),
        (("[0.0, 160.0]", "[160.0, 0.0]"), "a (2, 2) matrix that can be inverted"),
        (("brushless", "magnet"), "there is no pen lift 'magnet'"),
        (("[[160.0", "[160.0"), "is not TOML"),
    ],
)
def test_a_machine_file_that_says_something_wrong_is_refused(tmp_path: Path, change: tuple[str, str], part: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(OWN.replace(*change))
    with pytest.raises(BadInput, match=re.escape(part)):
        load_machine(str(file))


def test_a_machine_file_that_is_not_there_is_named() -> None:
    with pytest.raises(BadInput, match=r"cannot read the machine profile /nowhere/mine\.toml"):
        load_machine("/nowhere/mine.toml")


def test_the_default_machine_is_the_axidraw_v3_and_there_are_others() -> None:
    assert Settings.model_fields["machine"].default == "axidraw-v3"
    assert len(machine_names()) >= 3


def test_pen_times_follow_the_heights(tmp_path: Path) -> None:
    empty = tmp_path / "settings.toml"
    empty.write_text("")
    short = resolve({"pen_up": "40", "pen_down": "30"}, empty).values
    tall = resolve({"pen_up": "90", "pen_down": "30"}, empty).values
    assert short.lift_time < tall.lift_time
    assert short.lower_time < tall.lower_time


def test_the_lead_comes_from_the_quality_and_has_bounds() -> None:
    assert [resolve({"quality": quality}).values.lead for quality in ("draft", "normal", "fine")] == [0.75, 1.0, 1.0]
    assert resolve({"lead": "500ms"}).values.lead == 0.5
    with pytest.raises(BadInput, match=r"lead.*0\.15"):
        resolve({"lead": "0.1s"})
