"""Names of pictures in messages: the file or position that a user knows, no internal number."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe import units
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.sensor import check_light
from rfpipe.rigs.base import check_patterns

NAMES = {
    (0, 3): "pattern (0, 3)",
    (units.BLACK_LEVEL_KEY, 1): "all-off reference picture 1",
    (units.FLOODLIT_KEY, 0): "all-on reference picture 0",
    (units.WARM_UP_KEY, 5): "warm-up picture 5",
    (units.SYMMETRY_KEY, 4): "random pattern of the symmetry test, 4",
    (units.VERIFICATION_KEY, 2): "verification picture 2",
    (units.CHECK_PICTURE_KEY, 0, 7): "check picture 7",
    (units.SEQUENCE_KEY, 1): "reference picture of a sequence, 1",
}


@pytest.mark.parametrize("key", NAMES)
def test_messages_name_pictures_by_their_kind(key: tuple[int, ...]) -> None:
    with pytest.raises(CaptureError) as of_light:
        check_light(np.full((2, 2, 1), np.nan), key)
    with pytest.raises(InputError) as of_pattern:
        check_patterns(np.full((1, 2, 2), np.nan), [key], (2, 2))
    for caught in (of_light, of_pattern):
        assert NAMES[key] in str(caught.value)
        assert "100000" not in str(caught.value)
