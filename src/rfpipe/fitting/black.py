"""Pictures without the projector's light, checked against the pictures that they are for."""

from __future__ import annotations

from rfpipe.errors import InputError
from rfpipe.pictures import Header, relative_exposures


def black_scale(black: Header, picture: Header, names: tuple[str, str]) -> float:
    """Compute the factor by which a black picture is scaled before it is subtracted.

    Parameters
    ----------
    black, picture : Header
    names : (str, str)
        Names of the black picture and of the picture, for messages.

    Returns
    -------
    float
        Exposure of the picture over that of the black picture, both of time, sensitivity and
        aperture; for linear light. 1 where they differ by less than 1 %, or no file states any.

    Raises
    ------
    InputError
        When size, channels, kind or mosaic differ, or only one of the files states an exposure
        time, a sensitivity or an aperture.
    """
    black_name, name = names
    if black.size != picture.size:
        is_turned = black.size == picture.size[::-1]
        advice = "turn it by 90 degrees, as the pictures are" if is_turned else "give one as large"
        raise InputError(
            f"{black_name}: has {black.size[0]} x {black.size[1]} pixels (height x width), {name} "
            f"has {picture.size[0]} x {picture.size[1]}; {advice}"
        )
    for what in ("channels", "kind", "mosaic"):
        of_black, of_picture = getattr(black, what), getattr(picture, what)
        if of_black != of_picture:
            raise InputError(
                f"{black_name}: its {what} is {of_black}, that of {name} is {of_picture}; give a "
                "black picture by the same camera, in the same format"
            )
    of_picture, of_black = relative_exposures([picture, black], [name, black_name])
    return float(of_picture / of_black)
