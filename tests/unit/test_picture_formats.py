"""Picture files of all formats are read correctly, or refused with the reason."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageCms
from tests.files.dng import dng_bytes
from tests.files.tiffs import tiff_bytes

from rfpipe.errors import InputError
from rfpipe.pictures import (
    Header,
    check_raw_mosaic,
    check_sequence,
    developed,
    encoding_note,
    picture_files,
    pixel_fingerprint,
    read_header,
    read_parts,
    read_picture,
    relative_exposures,
)
from rfpipe.pictures.images import read_image, write_parts

HEIGHT, WIDTH = 4, 6
GRAY = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH, 1) * 5
COLOR = np.concatenate([GRAY, GRAY + 40, 250 - GRAY], axis=-1)
ALPHA = np.full((HEIGHT, WIDTH, 1), 51)
RGBA = np.concatenate([COLOR, ALPHA], axis=-1)
BYTES, FLOATS = COLOR.astype(np.uint8), COLOR.astype(np.float32)
SUFFIXES = {"jpeg": "jpg", "tiff": "tif"}
COUNTS_OF_FEW_BITS = np.arange(8).reshape(1, 8, 1) * 131
PNG_COLORS = {1: 0, 3: 2, 4: 6}


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(pixels: NDArray[Any], *chunks: bytes) -> bytes:
    """Return a PNG file of 8 or 16 bits with further chunks before its pixels."""
    height, width, channels = pixels.shape
    rows = b"".join(b"\0" + row.astype(row.dtype.newbyteorder(">")).tobytes() for row in pixels)
    form = (width, height, 8 * pixels.itemsize, PNG_COLORS[channels], 0, 0, 0)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", *form))
    pixels_chunk = chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(chunks) + pixels_chunk + chunk(b"IEND", b"")


def encoded(pixels: NDArray[Any], form: str, **options: Any) -> bytes:
    """Return a file written by Pillow."""
    file, image = BytesIO(), Image.fromarray(pixels)
    image.convert(options.pop("mode", image.mode)).save(file, form, **options)
    return file.getvalue()


def large(form: str) -> bytes:
    """Return a file of 64 x 96 noisy pixels."""
    noise = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    if form in ("exr", "hdr", "pfm"):
        return written(noise.astype(np.float32), form)
    return encoded(noise, form)


def written(
    pixels: NDArray[Any],
    suffix: str,
    data: tuple[int, int] = (0, 0),
    display: tuple[int, int, int, int] | None = None,
    names: tuple[str, ...] = (),
    **attributes: Any,
) -> bytes:
    """Return a file written by OpenImageIO.

    `data` is (x, y) of the data window, `display` (x, y, width, height) of the display window.
    """
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, str(pixels.dtype).replace("float32", "float"))
    spec.x, spec.y = data
    if display:
        spec.full_x, spec.full_y, spec.full_width, spec.full_height = display
    if names:
        spec.channelnames = names
    for name, value in attributes.items():
        spec.attribute(name, value)
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"a.{suffix}"
        output = oiio.ImageOutput.create(str(file))
        assert output.open(str(file), spec), output.geterror()
        assert output.write_image(pixels), output.geterror()
        output.close()
        return file.read_bytes()


def radiance(pixels: NDArray[Any], *lines: str, order: str = "-Y {h} +X {w}") -> bytes:
    """Return a Radiance file of integers below 256, with rows in the given order."""
    scanlines = np.zeros((pixels.shape[0] * pixels.shape[1], 4), np.uint8)
    scanlines[:, :3], scanlines[:, 3] = pixels.reshape(-1, 3), 136
    head = "\n".join(["#?RADIANCE", *lines, "FORMAT=32-bit_rle_rgbe", "", order, ""])
    return head.format(h=HEIGHT, w=WIDTH).encode() + scanlines.tobytes()


def turned(pixels: NDArray[Any], order: str) -> NDArray[Any]:
    """Return the scanlines of an image in the order of a Radiance file, such as +X -Y."""
    if "+Y" in order:
        pixels = pixels[::-1]
    if "-X" in order:
        pixels = pixels[:, ::-1]
    return np.swapaxes(pixels, 0, 1) if order.index("X") < order.index("Y") else pixels


def pfm(pixels: NDArray[np.float32], scale: float = -1.0) -> bytes:
    """Return a PFM file, with its rows from bottom to top."""
    kind = "PF" if pixels.shape[-1] == 3 else "Pf"
    order = "<f4" if scale < 0 else ">f4"
    head = f"{kind}\n{pixels.shape[1]} {pixels.shape[0]}\n{scale}\n".encode()
    return head + pixels[::-1].astype(order).tobytes()


def tga(pixels: NDArray[np.uint8], top: bool) -> bytes:
    """Return an uncompressed TGA file with its origin at the top or bottom."""
    height, width, channels = pixels.shape
    origin = 0x20 if top else 0
    head = struct.pack(
        "<3B5x4H2B", 0, 0, 2, 0, 0, width, height, 8 * channels, origin | 8 * (channels == 4)
    )
    bgra = pixels[..., [2, 1, 0, 3][:channels]]
    return head + (bgra if top else bgra[::-1]).tobytes()


def placed(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
    """Return the colour test picture at (x, y) within zeros of a window, cropped to it."""
    canvas = np.zeros((height + 40, width + 40, 3), np.float32)
    canvas[y + 20 : y + 20 + HEIGHT, x + 20 : x + 20 + WIDTH] = COLOR
    return canvas[20 : 20 + height, 20 : 20 + width]


def packed_tiff(bits: int, photometric: int = 1) -> bytes:
    """Return a gray TIFF file with packed samples of 9 to 15 bits."""
    text = "".join(f"{count:0{bits}b}" for count in COUNTS_OF_FEW_BITS.ravel())
    data = np.frombuffer(int(text, 2).to_bytes(len(text) // 8, "big"), np.uint8)
    tags = {256: COUNTS_OF_FEW_BITS.shape[1], 258: bits}
    return tiff_bytes(data[None], photometric=photometric, tags=tags)


def jpeg_with_exif(exif: dict[int, Any]) -> bytes:
    file = encoded(BYTES, "jpeg")
    block = b"Exif\0\0" + tiff_bytes(GRAY.astype(np.uint8), exif=exif)
    return file[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + file[2:]


ICC = {
    "srgb": ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
}
CURVE = ICC["srgb"][ICC["srgb"].index(b"para") :][:16]
ICC["linear"] = ICC["srgb"].replace(CURVE, b"para" + struct.pack(">4xHHI", 0, 0, 1 << 16))
COLOR_1 = COLOR / 255
ORDERS = [
    f"{slow} {fast}"
    for first, second in (("Y", "X"), ("X", "Y"))
    for slow in (f"-{first}", f"+{first}")
    for fast in (f"+{second}", f"-{second}")
]


def in_order(order: str) -> bytes:
    sizes = {"X": "{w}", "Y": "{h}"}
    line = " ".join(f"{axis} {sizes[axis[1]]}" for axis in order.split())
    return radiance(turned(COLOR, order), order=line)


READ: dict[str, tuple[bytes, str, NDArray[Any]]] = {
    # name: (file, suffix, linear pixels)
    **{
        f"tiff of {kind}": (tiff_bytes(COLOR.astype(kind)), "tif", COLOR / np.iinfo(kind).max)
        for kind in ("u1", "u2", "u4", "i2", "i4")
    },
    "tiff of 8 bits, signed": (tiff_bytes(GRAY.astype("i1")), "tif", GRAY / 127),
    "tiff of large counts of 32 bits": (
        tiff_bytes(COLOR.astype("u4") << 24), "tif", COLOR.astype("u4") * 2**24 / (2**32 - 1),
    ),
    **{
        f"tiff of {kind}": (tiff_bytes(COLOR.astype(kind)), "tif", FLOATS)
        for kind in ("f2", "f4", "f8")
    },
    **{
        f"tiff, MinIsWhite, {kind}": (
            tiff_bytes(GRAY.astype(kind), photometric=0), "tif", 1 - GRAY / np.iinfo(kind).max,
        )
        for kind in ("u1", "u2", "u4", "i2", "i1")
    },
    **{
        f"tiff with alpha, {name}": (
            tiff_bytes(RGBA.astype(np.uint8), extra_samples=[code]), "tif", COLOR_1,
        )
        for name, code in (("unspecified", 0), ("associated", 1), ("unassociated", 2))
    },
    "tiff, gray with alpha": (
        tiff_bytes(np.concatenate([GRAY, ALPHA], -1).astype("u2"), extra_samples=[2]),
        "tif", GRAY / 65535,
    ),
    "tiff with a thumbnail": (
        tiff_bytes(BYTES, BYTES[::2, ::2], page_tags={1: {254: 1}}), "tif", COLOR_1,
    ),
    "png of 16 bits": (png(COLOR.astype("u2")), "png", COLOR / 65535),
    "png with alpha": (png(RGBA.astype("u1")), "png", COLOR_1),
    "tga with alpha": (tga(RGBA.astype("u1"), True), "tga", COLOR_1),
    **{
        f"tiff of {bits} bits": (packed_tiff(bits), "tif", COUNTS_OF_FEW_BITS / (2**bits - 1))
        for bits in (10, 12, 14)
    },
    "tiff of 12 bits, MinIsWhite": (
        packed_tiff(12, 0), "tif", 1 - COUNTS_OF_FEW_BITS / 4095,
    ),
    "webp with alpha": (encoded(RGBA.astype("u1"), "webp", lossless=True), "webp", COLOR_1),
    "exr with alpha": (written(RGBA.astype(np.float32), "exr"), "exr", FLOATS),
    "tga from the bottom": (tga(BYTES, False), "tga", COLOR_1),
    "tga from the top": (tga(BYTES, True), "tga", COLOR_1),
    "bmp": (encoded(BYTES, "bmp"), "bmp", COLOR_1),
    "pgm": (b"P5\n6 4\n255\n" + GRAY.astype("u1").tobytes(), "pgm", GRAY / 255),
    "pgm of 10 bits": (b"P5\n6 4\n1023\n" + GRAY.astype(">u2").tobytes(), "pgm", GRAY / 1023),
    "pgm of text, with comments": (
        b"P2 # a\n6 # b\n4\n#c 9\n300\n" + b" ".join(b"%d" % count for count in GRAY.ravel()),
        "pgm", GRAY / 300,
    ),
    "ppm": (b"P6\n6 4\n255\n" + BYTES.tobytes(), "ppm", COLOR_1),
    "ppm of 16 bits": (b"P6\n6 4\n65535\n" + COLOR.astype(">u2").tobytes(), "ppm", COLOR / 65535),
    "pfm": (pfm(FLOATS), "pfm", FLOATS),
    "pfm, gray, big-endian": (pfm(GRAY.astype(np.float32), 1.0), "pfm", GRAY),
    **{f"hdr {order}": (in_order(order), "hdr", COLOR) for order in ORDERS},
    "hdr with EXPOSURE": (radiance(COLOR, "EXPOSURE=2.0"), "hdr", COLOR / 2),
    "hdr with two EXPOSUREs": (radiance(COLOR, "EXPOSURE=4", "EXPOSURE= 0.5"), "hdr", COLOR / 2),
    "hdr with EXPOSURE of an input": (radiance(COLOR, "\tEXPOSURE=4"), "hdr", COLOR),
    "hdr with COLORCORR": (
        radiance(COLOR, "COLORCORR= 1 2 4", "EXPOSURE=2"), "hdr", COLOR / np.array([2, 4, 8]),
    ),
    "exr, autocropped": (written(FLOATS, "exr", (2, 1), (0, 0, 12, 9)), "exr", placed(2, 1, 12, 9)),
    "exr with overscan": (
        written(FLOATS, "exr", (-2, -1), (0, 0, 3, 2)), "exr", placed(-2, -1, 3, 2),
    ),
    "exr, partly outside": (
        written(FLOATS, "exr", (-2, 3), (0, 0, 8, 5)), "exr", placed(-2, 3, 8, 5),
    ),
    "exr in an offset window": (
        written(FLOATS, "exr", (7, 5), (6, 5, 9, 5)), "exr", placed(1, 0, 9, 5),
    ),
    "png named as tif": (png(BYTES), "tif", COLOR_1),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_as_linear_light(tmp_path: Path, name: str) -> None:
    """Both readers, of photographs and of panoramas and patterns, give the same light."""
    data, suffix, expected = READ[name]
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(data)
    picture, (part,) = read_picture(file), read_parts(file)
    assert picture.header == read_header(file) == part.header
    if picture.header.kind == "counts":
        np.testing.assert_array_equal(picture.pixels, np.rint(expected * picture.white))
    assert picture.pixels.shape == (*picture.header.size, picture.header.channels)
    np.testing.assert_allclose(picture.fractions, expected, rtol=1e-6)
    np.testing.assert_array_equal(part.read().pixels, picture.pixels)
    np.testing.assert_allclose(np.atleast_3d(read_image(file)), expected, rtol=1e-6)
    if suffix not in ("hdr", "webp"):
        assert picture_files(tmp_path) == [file]


CUT = {form: large(form) for form in ("jpeg", "png", "tiff", "exr", "hdr", "pfm", "ppm", "bmp")}
REFUSED: dict[str, tuple[bytes, str, str]] = {
    # name: (file, suffix, message)
    **{
        f"half a {form}": (data[: len(data) // 2], SUFFIXES.get(form, form), "cut or damaged|can't")
        for form, data in CUT.items()
    },
    "jpeg without its last block": (CUT["jpeg"][:-200], "jpg", "is cut or damaged"),
    "half a jpeg with an end marker": (
        CUT["jpeg"][: len(CUT["jpeg"]) // 2] + b"\xff\xd9", "jpg", "is cut or damaged",
    ),
    "progressive jpeg, cut": (
        encoded(np.tile(BYTES, (9, 9, 1)), "jpeg", progressive=True)[:-40], "jpg", "is cut or",
    ),
    "negative counts": (tiff_bytes(GRAY.astype("i2") - 9), "tif", "negative counts, down to -9"),
    "MinIsWhite of floats": (tiff_bytes(FLOATS[..., :1], photometric=0), "tif", "MinIsWhite"),
    "5 bands": (
        tiff_bytes(np.dstack([RGBA, GRAY]).astype("u2"), extra_samples=[0, 0]), "tif", "has 5 bands"
    ),
    "4 bands that aren't colours": (
        tiff_bytes(RGBA.astype("u2"), photometric=1, extra_samples=[0, 0, 0]), "tif", "has 4 bands",
    ),
    "2 bands": (
        tiff_bytes(RGBA[..., :2].astype("u2"), extra_samples=[0]), "tif", "expected one channel",
    ),
    "CMYK": (tiff_bytes(RGBA.astype("u1"), photometric=5), "tif", "holds CMYK"),
    "CMYK jpeg": (encoded(BYTES, "jpeg", mode="CMYK"), "jpg", "holds CMYK"),
    "CIELAB": (tiff_bytes(BYTES, photometric=8), "tif", "holds CIELAB"),
    "5 pages": (tiff_bytes(*[BYTES] * 5), "tif", "holds 5 pictures"),
    **{
        f"animated {form}": (
            encoded(
                BYTES, form, save_all=True,
                append_images=[Image.fromarray(BYTES // 2), Image.fromarray(BYTES // 3)],
            ),
            form, "holds 3 pictures",
        )
        for form in ("gif", "png", "webp")
    },
    "exr without a pixel in its window": (
        written(FLOATS, "exr", (70, 50), (0, 0, 5, 5)), "exr", "no pixel within its display window",
    ),
    "exr of three layers": (
        written(FLOATS, "exr", names=("a.R", "a.G", "a.B")), "exr", "has the channels",
    ),
    "hdr of XYZE": (radiance(COLOR).replace(b"rgbe", b"xyze"), "hdr", "can't be read"),
    "hdr with a bad EXPOSURE": (radiance(COLOR, "EXPOSURE=0"), "hdr", "EXPOSURE=0.*positive"),
    **{f"empty {name}": (b"", name, "can't be read") for name in ("png", "exr", "tif", "jpg")},
    **{
        f"text named {suffix}": (b"these are words\n" * 9, suffix, "can't be read")
        for suffix in ("png", "exr", "tif", "jpg", "hdr", "tga", "bmp", "pgm", "pfm", "dng")
    },
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_is_refused_with_its_reason(tmp_path: Path, name: str) -> None:
    data, suffix, message = REFUSED[name]
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(data)
    for read in (read_picture, read_image):
        with pytest.raises(InputError, match=rf"a\.{suffix}: .*({message})"):
            read(file)


def test_a_complete_jpeg_is_not_reported_as_truncated(tmp_path: Path) -> None:
    """Cameras write padding before the end and bytes after it; both are harmless."""
    data = CUT["jpeg"]
    for index, harmless in enumerate((data, data + b"trailer", data[:-2] + b"\0\0" + data[-2:])):
        (tmp_path / f"{index}.jpg").write_bytes(harmless)
        assert read_picture(tmp_path / f"{index}.jpg").pixels.shape == (64, 96, 3)


@pytest.mark.parametrize("suffix", ["png", "tif", "exr", "jpg", "dng"])
def test_a_folder_with_the_name_of_a_picture_is_refused(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"a.{suffix}").mkdir()
    for read in (read_picture, read_header, read_image):
        with pytest.raises(InputError, match=rf"a\.{suffix}: (is a folder|can't be read)"):
            read(tmp_path / f"a.{suffix}")


def test_damage_anywhere_in_an_exr_header_raises_no_other_error(tmp_path: Path) -> None:
    """OpenImageIO's message may contain bytes of the file that aren't valid text."""
    data = written(FLOATS, "exr", ExposureTime=0.25, Make="camera")
    refused = 0
    for place in range(0, data.index(b"screenWindowWidth"), 3):
        for value in (0xFF, 0x00, 0x7F):
            damaged = bytearray(data)
            damaged[place] = value
            (tmp_path / "a.exr").write_bytes(damaged)
            try:
                read_picture(tmp_path / "a.exr")
            except InputError:
                refused += 1
    assert refused > 50


def test_pages_of_tiff_and_parts_of_exr_are_parts(tmp_path: Path) -> None:
    pages = [COLOR.astype("u2") * factor for factor in (1, 2, 3)]
    (tmp_path / "a.tif").write_bytes(tiff_bytes(*pages))
    floats = [page.astype(np.float32) for page in pages]
    write_parts(tmp_path / "a.exr", ["x", "y", "z"], FLOATS.shape, floats)
    for suffix, names in (("tif", ["0", "1", "2"]), ("exr", ["x", "y", "z"])):
        parts = read_parts(tmp_path / f"a.{suffix}")
        assert [part.name for part in parts] == names
        for part, page in zip(reversed(parts), reversed(pages), strict=True):
            np.testing.assert_array_equal(part.read().pixels, page)


def test_panoramas_are_upright_and_photographs_in_the_order_of_the_sensor(tmp_path: Path) -> None:
    upright = {
        1: BYTES, 2: BYTES[:, ::-1], 3: BYTES[::-1, ::-1], 4: BYTES[::-1],
        5: BYTES.swapaxes(0, 1), 6: np.rot90(BYTES, 3), 7: np.rot90(BYTES, 2).swapaxes(0, 1),
        8: np.rot90(BYTES),
    }  # fmt: skip
    for orientation, expected in upright.items():
        (tmp_path / "a.tif").write_bytes(tiff_bytes(BYTES, tags={274: orientation}))
        np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").pixels, BYTES)
        np.testing.assert_allclose(read_image(tmp_path / "a.tif"), expected / 255, rtol=1e-6)


# transfer curves

ENCODINGS: dict[str, tuple[bytes, str, str | None]] = {
    "jpeg": (encoded(BYTES, "jpeg"), "jpg", "srgb"),
    "jpeg with a linear profile": (
        encoded(BYTES, "jpeg", icc_profile=ICC["linear"]), "jpg", "linear",
    ),
    "png": (png(BYTES), "png", None),
    "png, sRGB": (png(BYTES, chunk(b"sRGB", b"\0")), "png", "srgb"),
    "png, gAMA of 1": (png(BYTES, chunk(b"gAMA", struct.pack(">I", 100_000))), "png", "linear"),
    "png, gAMA of 1 / 2.2": (png(BYTES, chunk(b"gAMA", struct.pack(">I", 45_455))), "png", "srgb"),
    "png, gAMA of 1 / 1.8": (png(BYTES, chunk(b"gAMA", struct.pack(">I", 55_556))), "png", "other"),
    "png, cICP of sRGB": (png(BYTES, chunk(b"cICP", bytes([1, 13, 0, 1]))), "png", "srgb"),
    "png, cICP, linear": (png(BYTES, chunk(b"cICP", bytes([1, 8, 0, 1]))), "png", "linear"),
    "png with a profile": (
        png(BYTES, chunk(b"iCCP", b"x\0\0" + zlib.compress(ICC["srgb"]))), "png", "srgb",
    ),
    "tiff": (tiff_bytes(BYTES), "tif", None),
    "tiff, Exif of sRGB": (tiff_bytes(BYTES, exif={40961: 1}), "tif", "srgb"),
    "tiff, Exif, uncalibrated": (tiff_bytes(BYTES, exif={40961: 65535}), "tif", None),
    "tiff with a profile": (encoded(BYTES, "tiff", icc_profile=ICC["srgb"]), "tif", "srgb"),
    "tiff with a linear profile": (
        encoded(BYTES, "tiff", icc_profile=ICC["linear"]), "tif", "linear",
    ),
    "bmp": (encoded(BYTES, "bmp"), "bmp", None),
    "exr": (written(FLOATS, "exr"), "exr", "linear"),
}  # fmt: skip


@pytest.mark.parametrize("name", ENCODINGS)
def test_the_transfer_curve_that_a_file_states(tmp_path: Path, name: str) -> None:
    data, suffix, encoding = ENCODINGS[name]
    (tmp_path / f"a.{suffix}").write_bytes(data)
    header = read_header(tmp_path / f"a.{suffix}")
    assert header.encoding == encoding
    note = encoding_note([header], ["a"], None)
    assert (note is not None) == (encoding in ("srgb", "other"))
    assert encoding_note([header], ["a"], "linear") is None


# exposures

EXIF: dict[str, tuple[dict[int, Any], tuple[float | None, float | None, float | None]]] = {
    "all three": ({33434: 0.25, 33437: 4.0, 34855: 400}, (0.25, 400, 4)),
    "APEX values": ({37377: 2.0, 37378: 4.0, 34855: 100}, (0.25, 100, 4)),
    "APEX value of 4 s": ({37377: -2.0}, (4, None, None)),
    "time before APEX value": ({33434: 1 / 3, 37377: 1.5}, (1 / 3, None, None)),
    "lens without contacts": ({33434: 0.5, 33437: 0.0}, (0.5, None, None)),
    "none": ({40961: 1}, (None, None, None)),
}


@pytest.mark.parametrize("name", EXIF)
@pytest.mark.parametrize("suffix", ["tif", "jpg"])
def test_exposure_comes_from_exif(tmp_path: Path, name: str, suffix: str) -> None:
    exif, expected = EXIF[name]
    data = tiff_bytes(BYTES, exif=exif) if suffix == "tif" else jpeg_with_exif(exif)
    (tmp_path / f"a.{suffix}").write_bytes(data)
    header = read_header(tmp_path / f"a.{suffix}")
    for value, number in zip(
        (header.exposure_s, header.iso, header.f_number), expected, strict=True
    ):
        assert value is None if number is None else value == pytest.approx(number, rel=1e-3)


def header(
    seconds: float | None = None, iso: float | None = None, f_number: float | None = None
) -> Header:
    return Header((4, 6), 3, "counts", seconds, iso, f_number)


EXPOSURES: dict[str, tuple[list[Header], list[float] | str]] = {
    "no metadata": ([header(), header()], [1, 1]),
    "one exposure": ([header(0.5, 100, 4), header(0.502, 100, 4)], [1, 1]),
    "times differ": ([header(0.5), header(0.25)], [0.5, 0.25]),
    "sensitivity differs": ([header(0.5, 100), header(0.5, 400)], [0.5, 2]),
    "aperture differs": ([header(0.5, 100, 2), header(0.5, 100, 4)], [0.5, 0.125]),
    "they cancel": ([header(0.5, 100, 4), header(0.25, 200, 4)], [1, 1]),
    "one lacks a time": ([header(0.5), header(), header(0.5)], "b: states no exposure time"),
    "two lack a time": ([header(), header(), header(0.5)], "a: states no exposure time, as 1 more"),
    "one lacks a sensitivity": ([header(1, 100), header(1)], "b: states no sensitivity"),
    "one lacks an aperture": ([header(1, 9, 2), header(1, 9)], "b: states no aperture"),
    "sensitivity without times": ([header(None, 100), header(None, 200)], "b: has another"),
}


@pytest.mark.parametrize("name", EXPOSURES)
def test_exposures_are_divided_out_or_refused(name: str) -> None:
    headers, expected = EXPOSURES[name]
    names = list("abc")[: len(headers)]
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            relative_exposures(headers, names)
    else:
        np.testing.assert_allclose(relative_exposures(headers, names), expected)


# raw files

X_TRANS = "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"
COLORS = {"R": 5000, "G": 1000, "B": 9000}


def raw_file(mosaic: str, size: tuple[int, int] = (36, 48), **options: Any) -> bytes:
    """Return a DNG file of a uniform colour, `COLORS` in counts."""
    period = int(len(mosaic) ** 0.5)
    tile = np.array([COLORS[letter] for letter in mosaic], np.uint16).reshape(period, period)
    counts = np.tile(tile, (size[0] // period, size[1] // period))
    return dng_bytes(counts, 0.25, mosaic, black=512, white=16383, **options)


@pytest.mark.parametrize("mosaic", ["RGGB", "BGGR", "GRBG", "GBRG", X_TRANS])
def test_raw_files_are_developed_to_linear_colours(tmp_path: Path, mosaic: str) -> None:
    (tmp_path / "a.dng").write_bytes(raw_file(mosaic))
    picture = developed(tmp_path / "a.dng")
    (part,) = read_parts(tmp_path / "a.dng", develop_raw=True)
    assert picture.header == part.header == read_header(tmp_path / "a.dng", develop_raw=True)
    assert (picture.header.size, picture.header.channels) == ((36, 48), 3)
    assert picture.header.exposure_s == pytest.approx(0.25)
    expected = [(COLORS[letter] - 512) / (16383 - 512) for letter in "RGB"]
    inside = picture.fractions[6:-6, 6:-6]
    tolerance = 5e-3 if mosaic == X_TRANS else 1e-3  # LibRaw's method for X-Trans is not exact
    np.testing.assert_allclose(inside, np.broadcast_to(expected, inside.shape), rtol=tolerance)
    assert read_image(tmp_path / "a.dng").shape == (36, 48, 3)


def test_developing_does_not_depend_on_the_picture(tmp_path: Path) -> None:
    """Dim pictures are not brightened, and bright ones not dimmed."""
    for name, level in (("dim", 612), ("bright", 12_512)):
        counts = np.full((32, 48), level, np.uint16)
        file = tmp_path / f"{name}.dng"
        file.write_bytes(dng_bytes(counts, 0.25, black=512, white=16383))
        light = developed(file).fractions
        np.testing.assert_allclose(light, (level - 512) / (16383 - 512), atol=1 / 65535)


MOSAICS: dict[str, tuple[str, str | None, str | None]] = {
    # name: (mosaic of the file, camera.bayer, message)
    "as set": ("RGGB", "RGGB", None),
    "red and blue exchanged": ("BGGR", "RGGB", "colour mosaic BGGR, but camera.bayer is RGGB"),
    "shifted by a column": ("GRBG", "RGGB", "colour mosaic GRBG, but camera.bayer is RGGB"),
    "no mosaic set": ("RGGB", None, "colour mosaic RGGB, but camera.bayer is null"),
    "X-Trans": (X_TRANS, "RGGB", "X-Trans, which is not one of 2 x 2"),
    "X-Trans, none set": (X_TRANS, None, "X-Trans, which is not one of 2 x 2"),
}


@pytest.mark.parametrize("name", MOSAICS)
def test_the_mosaic_of_a_raw_file_must_equal_the_settings(tmp_path: Path, name: str) -> None:
    mosaic, bayer, message = MOSAICS[name]
    (tmp_path / "a.dng").write_bytes(raw_file(mosaic))
    header = read_header(tmp_path / "a.dng")
    assert read_picture(tmp_path / "a.dng").header == header
    assert header.mosaic == ("X-Trans" if mosaic == X_TRANS else mosaic)
    if message is None:
        check_raw_mosaic(tmp_path / "a.dng", header, bayer)
    else:
        with pytest.raises(InputError, match=rf"a\.dng: .*{message}"):
            check_raw_mosaic(tmp_path / "a.dng", header, bayer)


# sequences


def sequence(folder: Path, *names: str) -> list[Path]:
    """Return files with different contents, in the order of `picture_files`."""
    for name in names:
        (folder / name).write_bytes(name.encode())
    return picture_files(folder, (".jpg",))


SEQUENCES: dict[str, tuple[list[str], str | None]] = {
    # name: (names of files, note)
    "in a row": ([f"IMG_{index:04d}.tif" for index in range(5, 15)], None),
    "in steps of 15": ([f"{index}.tif" for index in range(0, 360, 15)], None),
    "rows and columns": ([f"r{row}_c{column}.tif" for row in (1, 2) for column in (3, 4)], None),
    "names": (["cat.tif", "dog.tif", "owl.tif"], None),
    "of two kinds": (["a_1.tif", "a_2.tif", "white.tif"], None),
    "one missing": (
        [f"IMG_{index}.tif" for index in range(98, 110) if index != 100],
        "no number between IMG_99.tif and IMG_101.tif: ",
    ),
    "two missing": (
        [f"{index}.tif" for index in range(20) if index not in (4, 9)],
        "no number between 3.tif and 5.tif, and 1 more gaps: ",
    ),
}


@pytest.mark.parametrize("name", SEQUENCES)
def test_gaps_in_numbers_are_noted(tmp_path: Path, name: str) -> None:
    names, note = SEQUENCES[name]
    files = sequence(tmp_path, *names)
    assert [text.split("pictures")[0] for text in check_sequence(files)] == ([note] if note else [])
    assert check_sequence(files, ordered=False) == []


def test_a_counter_that_wrapped_is_refused(tmp_path: Path) -> None:
    names = [f"IMG_{index:04d}.tif" for index in (9997, 9998, 9999, 1, 2)]
    files = sequence(tmp_path, *names)
    assert files[0].name == "IMG_0001.tif"
    with pytest.raises(InputError, match=r"IMG_9997.tif to IMG_9999.tif: the camera's counter"):
        check_sequence(files)
    assert check_sequence(files, ordered=False) == []


@pytest.mark.parametrize("names", [("IMG_1.tif", "IMG_1.jpg"), ("a.TIF", "A.png", "b.png")])
def test_one_picture_in_two_files_is_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=r"has the name of .* with another suffix"):
        check_sequence(sequence(tmp_path, *names))


def test_a_picture_stored_twice_is_noted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (8, 8, 3)).astype(np.uint8) for _ in range(3)]
    for index, picture in enumerate((pictures[0], pictures[1], pictures[0], pictures[2])):
        (tmp_path / f"{index}.tif").write_bytes(tiff_bytes(picture))
    files = picture_files(tmp_path)
    assert check_sequence(files) == ["0.tif, 2.tif: are the same picture, stored more than once"]
    (tmp_path / "2.tif").write_bytes(tiff_bytes(pictures[0], exif={33434: 0.5}))
    assert check_sequence(files) == []  # other bytes
    prints = [pixel_fingerprint(read_picture(file).pixels) for file in files]
    assert len(check_sequence(files, fingerprints=prints)) == 1
