"""Roles of the picture files in a folder, by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import InputError
from rfpipe.pictures.names import stem_key

_MASK = re.compile(r"(^|.*[._-])mask")
_AMBIENT = re.compile(r"(^|.*[._-])ambient")
_RESULT = re.compile(r"(^|.*[._-])(normals?([._-]?(gt|map))?|albedo)")


@dataclass(frozen=True)
class SortedPictures:
    """Picture files of a folder by their roles.

    Attributes
    ----------
    pictures : tuple of Path
        Pictures of patterns or single lights, in the order in which they were given.
    mask : Path or None
        Mask of the object, such as ``mask.png`` or ``cat.mask.png``.
    ambient : tuple of Path
        Pictures of ambient light alone, such as ``ambient.tif`` or ``vase_ambient.tif``.
    ignored : tuple of Path
        Results that lie beside the pictures, such as ``normals.png``, ``Normal_gt.png`` or
        ``albedo.png``.
    """

    pictures: tuple[Path, ...]
    mask: Path | None = None
    ambient: tuple[Path, ...] = ()
    ignored: tuple[Path, ...] = ()


def sort_pictures(files: Sequence[Path], light_names: Sequence[str] = ()) -> SortedPictures:
    """Sort the picture files of a folder by their roles.

    Parameters
    ----------
    files : sequence of Path
    light_names : sequence of str
        Names of pictures in a file of lights: these are pictures of lights, whatever their names.

    Raises
    ------
    InputError
        If there are several masks, or no pictures beside other files.
    """
    named = {stem_key(name) for name in light_names}
    pictures, masks, ambient, ignored = (list[Path]() for _ in range(4))
    for file in files:
        stem = stem_key(file.name)
        if stem in named:
            pictures.append(file)
        elif _MASK.fullmatch(stem):
            masks.append(file)
        elif _AMBIENT.fullmatch(stem):
            ambient.append(file)
        elif _RESULT.fullmatch(stem):
            ignored.append(file)
        else:
            pictures.append(file)
    if len(masks) > 1:
        raise InputError(
            f"{masks[0]} and {masks[1].name} are both masks by their names; keep one of them there"
        )
    if files and not pictures:
        raise InputError(
            f"{files[0].parent}: has no pictures of patterns or lights, only {files[0].name} and "
            "the like, which are a mask, ambient light or results by their names; rename them"
        )
    return SortedPictures(tuple(pictures), next(iter(masks), None), tuple(ambient), tuple(ignored))
