"""The exposure times of photo cameras."""

import pytest

from rfpipe.errors import InputError
from rfpipe_devices.gphoto_library import nearest_times, shutter_times

THIRDS = (
    "30", "25", "20", "2.5", "1", "0.8", "0.6", "0.5", "1/13", "1/15", "1/60", "1/80", "1/125",
    "1/8000", "bulb", "auto",
)  # fmt: skip
HALVES = ("15", "11", "8", "3", "1.5", "1", "0.7", "1/2", "1/11", "1/45", "1/60", "1/90", "Time")


def test_names_stand_for_thirds_of_a_stop() -> None:
    times = shutter_times(THIRDS)
    assert len(times) == len(THIRDS) - 2
    by_name = {time.name: time.seconds for time in times}
    assert (by_name["1/60"], by_name["1/125"], by_name["30"]) == (1 / 64, 1 / 128, 32)
    assert by_name["1/80"] == pytest.approx(2 ** (-19 / 3))


def test_names_stand_for_halves_of_a_stop() -> None:
    times = shutter_times(HALVES)
    assert len(times) == len(HALVES) - 1
    by_name = {time.name: time.seconds for time in times}
    assert by_name["1/45"] == pytest.approx(2**-5.5)
    assert by_name["0.7"] == pytest.approx(2**-0.5)


def test_the_nearest_by_ratio() -> None:
    times = shutter_times(THIRDS)
    names = [time.name for time in nearest_times((1 / 64, 0.07, 1.1), times)]
    assert names == ["1/60", "1/15", "1"]
    with pytest.raises(InputError, match="two times for which the camera's nearest is 1;"):
        nearest_times((1.0, 1.1), times)
    with pytest.raises(InputError, match="lists no exposure times; turn its mode dial to M"):
        nearest_times((1.0,), [])
