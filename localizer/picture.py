"""A picture's file as the pixels that the sensor delivered, or one named error; nothing is printed on the way."""

import warnings
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


class PictureError(SkyfixError):
    """A picture that cannot be used. The message goes on after the file's name."""


def decode_picture(content: bytes, width_px: int, height_px: int) -> NDArray[np.uint8]:
    """BGR, (height_px, width_px, 3), as stored: an orientation tag does not turn it, transparency is left out.

    Grey pictures become three equal channels, of 16 bits the upper eight are kept. The size is looked at before anything
    is decoded. Raises ``PictureError``.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of doubtful metadata, which does not concern the pixels
            with Image.open(BytesIO(content), formats=FORMATS) as picture:
                if picture.size != (width_px, height_px):
                    raise PictureError(
                        f"is {picture.size[0]} x {picture.size[1]} px, "
                        f"but camera.width_px x camera.height_px is {width_px} x {height_px}"
                    )
                return _pixels(picture)
    except UnidentifiedImageError:
        raise PictureError(f"is not a picture that can be read (neither {' nor '.join(FORMATS)})") from None
    except Image.DecompressionBombError:
        raise PictureError("is not a picture that can be read (it has far too many pixels)") from None
    # what the library's decoders raise on broken files, all of it about the content
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise PictureError(f"is not a picture that can be read ({error})") from None


def _pixels(picture: Image.Image) -> NDArray[np.uint8]:
    if picture.mode == "F":
        raise PictureError("is not a picture that can be read (its values are fractions)")
    if picture.mode.startswith("I"):
        grey = (np.asarray(picture).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    rgb = np.asarray(picture.convert("RGB"), np.uint8)
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), np.uint8)
