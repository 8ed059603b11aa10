"""Appearance models of sky and terrain: log-odds terrain : sky of each pixel.

`generic_log_odds` holds for most images: sky is smooth, bright and bluish. Given a first boundary, `fitted_odds` fits models of
the image itself to the pixels above and below. The sky's colour is a second-order polynomial of position (brighter towards the
sun, paler towards the horizon) plus a histogram of deviations. A distant ridge of nearly the sky's colour then differs from
the sky next to it; clouds are deviations in the sky's histogram.
"""

import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel
from localizer.skyline.reduced_image import Floats, ReducedImage

_COLOUR_BINS = 15
_TEXTURE_BINS = 12
_SAMPLE_EVERY = 5


def generic_log_odds(work: ReducedImage) -> Floats:
    """Log-odds terrain : sky of each pixel by coefficients that hold for most images; (h, w)."""
    h = work.texture.shape[0]
    row = np.arange(h, dtype=np.float32)[:, None] / h
    typical = np.float32(np.median(work.bright[::3, ::3]))
    odds = (
        np.float32(2.5) * work.texture
        - np.float32(4.7) * work.blueness
        - np.float32(15.3) * (work.bright - typical)
    )
    return np.asarray(odds + np.float32(0.4) * row - np.float32(0.35), np.float32)


def fitted_odds(work: ReducedImage, boundary: NDArray[np.int64], sky_share: float) -> Floats:
    """Log odds terrain : sky per pixel from models fitted on either side of `boundary` (w rows); (h, w).

    The sky's model is fitted only to the upper share `sky_share` of the pixels above the boundary: the lowest part may be a
    distant ridge mistaken for sky.
    """
    h, w = work.texture.shape
    sky_end = np.minimum((sky_share * boundary).astype(np.int64), boundary - 2)
    rows, cols = np.mgrid[0:h:_SAMPLE_EVERY, 0:w:_SAMPLE_EVERY]
    inside = rows < sky_end[cols]
    rows, cols = rows[inside], cols[inside]
    if rows.size < 20:
        return np.zeros((h, w), np.float32)
    coef, sigma = _fit_sky(work.lab[rows, cols], _terms(rows, cols, h, w))
    low, high = float(work.texture.min()), float(work.texture.max()) + 1e-3
    colour, texture, colour_counts, texture_counts = _count_cells(
        work.lab,
        work.texture,
        boundary,
        sky_end,
        coef,
        np.float32(1) / sigma,
        int(rows.max()),
        low,
        _TEXTURE_BINS / (high - low),
    )
    p = _smooth_colours(colour_counts)
    q = _smooth_textures(texture_counts)
    return _look_up(
        colour,
        texture,
        np.clip(np.log(p[1] / p[0]), -4, 4).astype(np.float32),
        np.clip(np.log(q[1] / q[0]), -2, 2).astype(np.float32),
    )


def _terms(rows: NDArray[np.int64], cols: NDArray[np.int64], h: int, w: int) -> Floats:
    """Second-order terms of the position, (n, 6)."""
    x = 2.0 * cols / w - 1.0
    y = rows / h
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).astype(np.float32)


def _fit_sky(colour: Floats, terms: Floats) -> tuple[Floats, Floats]:
    """Coefficients (6, 3) of the clear sky's colour and the robust sigma (3,) of the deviations, by iterative reweighting."""
    weight = np.ones(colour.shape[0], np.float32)
    coef = np.zeros((6, 3), np.float32)
    sigma = np.ones(3, np.float32)
    for _ in range(4):
        weighted = terms * weight[:, None]
        coef = np.linalg.solve(weighted.T @ terms + 1e-3 * np.eye(6, dtype=np.float32), weighted.T @ colour)
        departure = colour - terms @ coef
        sigma = np.maximum(1.4826 * np.median(np.abs(departure), axis=0), 0.5)
        weight = (1.0 / (1.0 + ((departure / (2 * sigma)) ** 2).sum(axis=1))).astype(np.float32)
    return coef.astype(np.float32), sigma.astype(np.float32)


@kernel()
def _count_cells(
    lab: Floats,
    texture: Floats,
    boundary: NDArray[np.int64],
    sky_end: NDArray[np.int64],
    coef: Floats,
    inverse_sigma: Floats,
    lowest_row: int,
    texture_low: float,
    texture_scale: float,
) -> tuple[NDArray[np.int16], NDArray[np.int16], Floats, Floats]:
    """Histograms of the deviation from the clear sky's colour and of the texture, for sky and for terrain.

    Bins are fine near zero deviation and coarse far from it. Below `lowest_row`, where no sky was fitted, the polynomial is
    held constant. Pixels near the boundary have more weight.

    Returns:
        Colour cell and texture cell per pixel (h, w); counts (2, cells) of sky and of terrain, of either kind.
    """
    h, w = texture.shape
    colour_cell = np.empty((h, w), np.int16)
    texture_cell = np.empty((h, w), np.int16)
    colour_counts = np.zeros((2, _COLOUR_BINS**3), np.float32)
    texture_counts = np.zeros((2, _TEXTURE_BINS), np.float32)
    near = np.exp(-np.arange(h + 1) / (0.25 * h)).astype(np.float32)
    for r in range(h):
        y = np.float32(min(r, lowest_row) / h)
        for i in range(w):
            x = np.float32(2.0 * i / w - 1.0)
            cell = 0
            for c in range(3):
                sky = (
                    coef[0, c]
                    + x * (coef[1, c] + x * coef[3, c] + y * coef[4, c])
                    + y * (coef[2, c] + y * coef[5, c])
                )
                d = (lab[r, i, c] - sky) * inverse_sigma[c]
                k = int(
                    np.float32(2.2) * d / (np.float32(1) + np.float32(0.3) * abs(d))
                    + np.float32(0.5 * _COLOUR_BINS)
                )
                cell = cell * _COLOUR_BINS + k
            t = int((texture[r, i] - texture_low) * texture_scale)
            colour_cell[r, i] = cell
            texture_cell[r, i] = t
            if r < sky_end[i]:
                weight = near[boundary[i] - r] + np.float32(0.2)
                colour_counts[0, cell] += weight
                texture_counts[0, t] += weight
            elif r >= boundary[i] + 2:
                weight = near[r - boundary[i]] + np.float32(0.05)
                colour_counts[1, cell] += weight
                texture_counts[1, t] += weight
    return colour_cell, texture_cell, colour_counts, texture_counts


def _smooth_colours(counts: Floats) -> Floats:
    """Probability per colour bin, (2, bins); a tenth of it is uniform, for colours that do not occur."""
    cube = counts.reshape(2, _COLOUR_BINS, _COLOUR_BINS, _COLOUR_BINS)
    for axis in (1, 2, 3):
        moved = np.moveaxis(cube, axis, 0)
        smooth = np.float32(0.6) * moved
        smooth[1:] += np.float32(0.2) * moved[:-1]
        smooth[:-1] += np.float32(0.2) * moved[1:]
        cube = np.moveaxis(smooth, 0, axis)
    flat = np.ascontiguousarray(cube).reshape(2, -1)
    flat /= np.maximum(flat.sum(axis=1, keepdims=True), np.float32(1e-6))
    return np.asarray((flat + np.float32(0.1 / flat.shape[1])) / np.float32(1.1), np.float32)


def _smooth_textures(counts: Floats) -> Floats:
    """Probability per texture cell, (2, cells)."""
    smooth = 0.5 * counts
    smooth[:, 1:] += 0.25 * counts[:, :-1]
    smooth[:, :-1] += 0.25 * counts[:, 1:]
    return np.asarray(smooth / np.maximum(smooth.sum(axis=1, keepdims=True), 1e-6) + 0.01, np.float32)


@kernel()
def _look_up(
    colour_cell: NDArray[np.int16], texture_cell: NDArray[np.int16], colour_odds: Floats, texture_odds: Floats
) -> Floats:
    """Sum of both odds per pixel, clipped to +- 4."""
    h, w = colour_cell.shape
    out = np.empty((h, w), np.float32)
    for r in range(h):
        for i in range(w):
            odds = colour_odds[colour_cell[r, i]] + texture_odds[texture_cell[r, i]]
            out[r, i] = min(max(odds, np.float32(-4)), np.float32(4))
    return out
