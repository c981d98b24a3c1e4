"""Exposure times of photo cameras by their names."""

import pytest

from rfpipe.devices.gphoto_library import nearest_times, shutter_times
from rfpipe.errors import InputError

THIRDS = (
    "30", "25", "20", "2.5", "1", "0.8", "0.6", "0.5", "1/13", "1/15", "1/60", "1/80", "1/125",
    "1/8000", "bulb", "auto",
)  # fmt: skip
HALVES = ("15", "11", "8", "3", "1.5", "1", "0.7", "1/2", "1/11", "1/45", "1/60", "1/90", "Time")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (THIRDS, {"1/60": 1 / 64, "1/125": 1 / 128, "30": 32, "1/80": 2 ** (-19 / 3)}),
        (HALVES, {"1/45": 2**-5.5, "0.7": 2**-0.5}),
    ],
)
def test_names_of_exposure_times_are_fractions_of_a_stop(
    names: tuple[str, ...], expected: dict[str, float]
) -> None:
    by_name = {time.name: time.seconds for time in shutter_times(names)}
    assert set(by_name) == set(names) - {"bulb", "auto", "Time"}
    assert {name: by_name[name] for name in expected} == pytest.approx(expected, rel=1e-15)


def test_the_nearest_time_is_by_ratio() -> None:
    times = shutter_times(THIRDS)
    names = [time.name for time in nearest_times((1 / 64, 0.07, 1.1), times)]
    assert names == ["1/60", "1/15", "1"]
    with pytest.raises(InputError, match="lists no exposure times; turn its mode dial to M"):
        nearest_times((1.0,), [])
