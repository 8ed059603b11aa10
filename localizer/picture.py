"""A picture's file as the pixels that the sensor delivered, or one named error; nothing is printed on the way."""

import warnings
from collections.abc import Callable
from io import BytesIO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from localizer.errors import SkyfixError

FORMATS = ("PNG", "JPEG", "BMP", "WEBP")
"""Not TIFF, whose library prints its own complaints."""
MOST_PIXELS = 150_000_000
"""No camera has more; a file of a few kilobytes can claim to."""
USED_SHARE = 0.995
"""Of the pixels; the others may be stuck."""
STUCK_BITS = 2
"""So many more than the other pixels use show that they are."""
ORIENTATION = 0x0112
UPRIGHT = 1
TURNED = (3, 5, 6, 7, 8)
"""Orientations that move the sky."""
SIDEWAYS = (5, 6, 7, 8)
"""Orientations that exchange width and height."""
_TURNS: dict[int, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.transpose(1, 0, 2),
    6: lambda p: np.rot90(p, -1),
    7: lambda p: np.rot90(p, 2).transpose(1, 0, 2),
    8: lambda p: np.rot90(p, 1),
}


class PictureError(SkyfixError):
    """A picture that cannot be used. The message goes on after the file's name."""


def decode_picture(
    content: bytes, width_px: int, height_px: int, quarter_turns: int = 0
) -> NDArray[np.uint8]:
    """BGR, (height_px, width_px, 3), transparency left out.

    The picture is as stored unless only its orientation tag (EXIF) makes it of that size, or the tag says that it stands on
    its head and the bundle (``quarters``, see ``upright``) that it does not. Grey pictures become three equal channels; of
    more than eight bits the upper eight of those that are used are kept. The size is looked at before anything is decoded.
    Raises ``PictureError``.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of doubtful metadata, which does not concern the pixels
            with Image.open(BytesIO(content), formats=FORMATS) as picture:
                turn = _turn(picture, (width_px, height_px), quarter_turns)
                size = picture.size[::-1] if turn in SIDEWAYS else picture.size
                if size != (width_px, height_px):
                    raise PictureError(
                        f"is {picture.size[0]} x {picture.size[1]} px, "
                        f"but camera.width_px x camera.height_px is {width_px} x {height_px}"
                    )
                pixels = _pixels(picture, content)
                return pixels if turn == UPRIGHT else np.ascontiguousarray(_TURNS[turn](pixels))
    except UnidentifiedImageError:
        raise PictureError(f"is not a picture that can be read (neither {' nor '.join(FORMATS)})") from None
    except Image.DecompressionBombError:
        raise PictureError("is not a picture that can be read (it has far too many pixels)") from None
    # what the library's decoders raise on broken files, all of it about the content
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise PictureError(f"is not a picture that can be read ({error})") from None


def _turn(picture: Image.Image, size: tuple[int, int], quarter_turns: int) -> int:
    """The orientation (EXIF 0x0112) to be honoured."""
    try:
        tag = int(picture.getexif().get(ORIENTATION, UPRIGHT))
    except (TypeError, ValueError, SyntaxError, OSError, EOFError):
        return UPRIGHT  # of doubtful metadata, which does not concern the pixels
    if tag not in _TURNS:
        return UPRIGHT
    shown = picture.size[::-1] if tag in SIDEWAYS else picture.size
    if shown != size or (picture.size == size and (quarter_turns != 0 or tag not in TURNED)):
        return UPRIGHT
    return tag


def _pixels(picture: Image.Image, content: bytes) -> NDArray[np.uint8]:
    if picture.mode == "F":
        raise PictureError("is not a picture that can be read (its values are fractions)")
    if picture.mode.startswith("I"):
        return np.repeat(_eight_bits(np.asarray(picture))[:, :, None], 3, axis=2)
    if picture.format == "PNG" and content[24:25] == b"\x10" and picture.mode in ("RGB", "RGBA", "LA"):
        picture.load()  # which refuses what is broken, without a word of the decoder's on the terminal
        deep = cv2.imdecode(
            np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
        )
        if deep is not None and deep.dtype == np.uint16 and deep.ndim == 3:
            return _eight_bits(deep[:, :, :3])
    rgb = np.asarray(picture.convert("RGB"), np.uint8)
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), np.uint8)


def _eight_bits(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Cameras of 10, 12 and 14 bits leave the upper ones of 16 empty, but for stuck pixels and a line of their own data."""
    whole = values.astype(np.int64)
    used, most = (
        int(np.quantile(whole, share, method="higher") if whole.size else 0).bit_length()
        for share in (USED_SHARE, 1.0)
    )
    used = most if most - used < STUCK_BITS else used
    return (whole >> max(used - 8, 0)).clip(0, 255).astype(np.uint8)
