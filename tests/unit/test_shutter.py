"""The exposure times of photo cameras."""

from itertools import pairwise

import pytest

from rfpipe.errors import InputError
from rfpipe_devices.gphoto_library import nearest_times, shutter_times

THIRDS = (
    "30", "25", "20", "15", "13", "10", "8", "6", "5", "4", "3.2", "2.5", "2", "1.6", "1.3", "1",
    "0.8", "0.6", "0.5", "0.4", "0.3", "1/4", "1/5", "1/6", "1/8", "1/10", "1/13", "1/15", "1/20",
    "1/25", "1/30", "1/40", "1/50", "1/60", "1/80", "1/100", "1/125", "1/160", "1/200", "1/250",
    "1/320", "1/400", "1/500", "1/640", "1/800", "1/1000", "1/4000", "1/8000", "bulb", "auto",
)  # fmt: skip
HALVES = (
    "15", "11", "8", "6", "4", "3", "2", "1.5", "1", "0.7", "1/2", "0.3", "1/4", "1/6", "1/8",
    "1/11", "1/15", "1/20", "1/30", "1/45", "1/60", "1/90", "1/125", "Time",
)  # fmt: skip


def test_names_stand_for_thirds_of_a_stop() -> None:
    times = shutter_times(THIRDS)
    assert len(times) == len(THIRDS) - 2
    for shorter, longer in pairwise(times):
        if shorter.name not in ("1/8000", "1/4000"):  # the list leaves some out there
            assert longer.seconds / shorter.seconds == pytest.approx(2 ** (1 / 3)), shorter.name
    by_name = {time.name: time.seconds for time in times}
    assert (by_name["1/60"], by_name["1/125"], by_name["30"]) == (1 / 64, 1 / 128, 32)


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
