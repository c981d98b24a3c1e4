"""Black pictures against the pictures from which they are subtracted."""

from dataclasses import replace

import pytest

from rfpipe.errors import InputError
from rfpipe.fitting.black import black_scale
from rfpipe.pictures import Header

PICTURE = Header((40, 60), 3, "counts", exposure_s=0.5, iso=100, f_number=8)
NAMES = ("black.tif", "IMG_1.tif")


@pytest.mark.parametrize(
    ("change", "scale"),
    [
        ({}, 1),
        ({"exposure_s": 0.25}, 2),
        ({"exposure_s": 2}, 0.25),
        ({"exposure_s": 0.503}, 1),  # rounded as by cameras
        ({"iso": 400}, 0.25),
        ({"f_number": 4}, 0.25),
        ({"exposure_s": 1, "iso": 50}, 1),
        ({"encoding": "srgb"}, 1),
    ],
)
def test_black_is_scaled_to_the_exposure_of_the_picture(change, scale: float) -> None:
    assert black_scale(replace(PICTURE, **change), PICTURE, NAMES) == pytest.approx(scale)


def test_files_without_metadata_are_alike() -> None:
    plain = Header((40, 60), 3, "counts")
    assert black_scale(plain, plain, NAMES) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": (40, 61)}, r"40 x 61 pixels.*has 40 x 60; give one as large"),
        ({"size": (60, 40)}, r"60 x 40 pixels.*has 40 x 60; turn it by 90 degrees"),
        ({"channels": 1}, "channels is 1, .* is 3"),
        ({"kind": "light"}, "kind is light, .* is counts"),
        ({"mosaic": "RGGB"}, "mosaic is RGGB, .* is None"),
        ({"exposure_s": None}, "states no exposure time"),
        ({"iso": None}, "states no sensitivity"),
        ({"f_number": None}, "states no aperture"),
    ],
)
def test_other_black_pictures_are_refused(change, message: str) -> None:
    black = replace(PICTURE, **change)
    with pytest.raises(InputError, match=rf"black\.tif: .*{message}"):
        black_scale(black, PICTURE, NAMES)
    if None in change.values():
        with pytest.raises(InputError, match=rf"IMG_1\.tif: .*{message}"):
            black_scale(PICTURE, black, NAMES)
