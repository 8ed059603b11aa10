"""Sub-pixel edge localisation at full resolution, near a rough boundary.

First the boundary is traced again pixel by pixel in a narrow band around the rough one, on the brightness projected onto the
local sky-minus-terrain colour. Then a step blurred by a Gaussian is fitted to each column's profile by least squares. Sky
level, terrain level and edge row are free; the blur is one value for the whole image.

A lens averages light, not display values; between a bright sky and dark terrain the difference is a few tenths of a pixel. The
fit therefore uses linear light. Only an image sharper than any lens produces is fitted in display values.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel
from localizer.skyline.boundary_path import min_marginals

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_BLURS_PX = (0.05, 0.3, 0.5, 0.75, 1.1, 1.6, 2.4)
_SAMPLED_COLUMNS = 120
_MARGIN_ROWS = 5
_CRISP_PX = 0.2
_SIGMA_SCALE = 1.3
_SIGMA_FLOOR_PX = 0.1

_DISPLAY = np.arange(256, dtype=np.float64)
_LINEAR = 255.0 * np.where(
    _DISPLAY <= 0.04045 * 255, _DISPLAY / (255 * 12.92), ((_DISPLAY / 255 + 0.055) / 1.055) ** 2.4
)
"""Linear light of display values (sRGB), on the scale 0..255."""


@dataclass(frozen=True)
class Edge:
    """The edge per column, each (width,).

    Attributes:
        row_px: row of the edge.
        sigma_px: its standard deviation.
        contrast: sky minus terrain in grey levels, along the colour that separates them; 0 where no step could be fitted.
        noise: grey levels, one number for the picture's sky.
    """

    row_px: Floats
    sigma_px: Floats
    contrast: Floats
    noise: float


def refine_edge(image_bgr: NDArray[np.uint8], rough_row_px: Floats, scale: float) -> Edge:
    """Sub-pixel edge near a rough boundary.

    Args:
        image_bgr: (height, width, 3).
        rough_row_px: (width,), finite, right to within about `scale` rows.
        scale: full-resolution rows per row of the picture in which the rough boundary was found.

    Returns:
        The edge; where no step could be fitted, the followed boundary with a sigma of `scale`.
    """
    allowed = math.ceil(scale) + 1
    half = allowed + _MARGIN_ROWS
    top = np.round(rough_row_px).astype(np.int64) - half + 1
    band = _profiles(image_bgr, _DISPLAY, top, half, 6)
    noise = max(1.4826 * float(np.median(np.abs(np.diff(band[:, : half - 1], n=2, axis=1)))) / 2.45, 0.5)
    unary, step = _follow_costs(_sky_distance(image_bgr, top, half, allowed, 6), top, noise, allowed)
    followed = min_marginals(unary, step).argmin(axis=1) - (top - top.min()) - 0.5
    absolute = followed + top
    slope = _slope(absolute)
    blur = _blur(band, followed, slope)
    if blur > _CRISP_PX:
        band = _profiles(image_bgr, _LINEAR, top, half, 6)
        blur = _blur(band, followed, slope)
    row, contrast, variance, factor = _fit_columns(band, followed, slope, blur, 1)
    pooled = 0.5 * variance + 0.5 * float(np.median(variance))
    sigma = np.sqrt(_SIGMA_SCALE**2 * pooled * factor + _SIGMA_FLOOR_PX**2 * (1 + slope**2))
    good = (np.abs(row - followed) < 2.5 + 0.5 * np.abs(slope)) & (contrast > 0) & (sigma < scale)
    return Edge(
        row_px=np.where(good, row, followed) + top,
        sigma_px=np.where(good, sigma, max(scale, 1.0) * np.sqrt(1 + slope**2)),
        contrast=np.where(good, contrast, 0.0),
        noise=noise,
    )


def _slope(row: Floats) -> Floats:
    """Rows per column over five columns."""
    if row.size < 6:
        return np.zeros(row.size)
    padded = np.pad(row, 2, mode="edge")
    return np.asarray((padded[4:] - padded[:-4]) / 4.0)


@kernel()
def _profiles(
    image: NDArray[np.uint8], light: Floats, top: NDArray[np.int64], half: int, smooth: int
) -> Floats32:
    """Band of 2 * half rows from `top` on, projected onto the unit colour vector from terrain to sky; (width, 2 * half).

    The vector is taken over +- `smooth` columns. Rows outside the picture repeat its first or last one.
    """
    height, width = image.shape[:2]
    difference = np.zeros((width, 3))
    for x in range(width):
        for k in range(half):
            above = min(max(top[x] + k, 0), height - 1)
            below = min(max(top[x] + half + k, 0), height - 1)
            for c in range(3):
                difference[x, c] += light[image[above, x, c]] - light[image[below, x, c]]
    band = np.empty((width, 2 * half), np.float32)
    running = np.zeros(3)
    for x in range(-smooth, width):
        for c in range(3):
            if x + smooth < width:
                running[c] += difference[x + smooth, c]
            if x - smooth - 1 >= 0:
                running[c] -= difference[x - smooth - 1, c]
        if x < 0:
            continue
        norm = max(math.sqrt(running[0] ** 2 + running[1] ** 2 + running[2] ** 2), 1e-9)
        for k in range(2 * half):
            y = min(max(top[x] + k, 0), height - 1)
            value = 0.0
            for c in range(3):
                value += light[image[y, x, c]] * running[c]
            band[x, k] = value / norm
    return band


@kernel()
def _sky_distance(
    image: NDArray[np.uint8], top: NDArray[np.int64], half: int, allowed: int, smooth: int
) -> Floats32:
    """Negative distance of each pixel's colour from the sky's, in a band as of `_profiles`; (width, 2 * half).

    With snow and rock side by side there is no single terrain colour to project onto.
    """
    height, width = image.shape[:2]
    rows = half - allowed
    sum_sky = np.zeros((width, 3))
    for x in range(width):
        for k in range(rows):
            y = min(max(top[x] + k, 0), height - 1)
            for c in range(3):
                sum_sky[x, c] += image[y, x, c]
    band = np.empty((width, 2 * half), np.float32)
    running = np.zeros(3)
    count = 0
    for x in range(-smooth, width):
        if x + smooth < width:
            count += rows
            for c in range(3):
                running[c] += sum_sky[x + smooth, c]
        if x - smooth - 1 >= 0:
            count -= rows
            for c in range(3):
                running[c] -= sum_sky[x - smooth - 1, c]
        if x < 0:
            continue
        for k in range(2 * half):
            y = min(max(top[x] + k, 0), height - 1)
            square = 0.0
            for c in range(3):
                square += (image[y, x, c] - running[c] / count) ** 2
            band[x, k] = -math.sqrt(square)
    return band


@kernel()
def _follow_costs(
    band: Floats32, top: NDArray[np.int64], noise: float, allowed: int
) -> tuple[Floats32, Floats32]:
    """Costs for `min_marginals`: state k is the edge above row min(top) + k, within `allowed` rows of the band's middle."""
    width, n = band.shape
    first = top.min()
    states = top.max() + n - first
    unary = np.full((width, states + 1), np.float32(1e4))
    step = np.full((width - 1, states), np.float32(0.3))
    for x in range(width):
        passed = 0.0
        before = 0.0
        for k in range(n // 2 - allowed, n // 2 + allowed + 1):
            rise = 0.5 * (band[x, k - 1] + band[x, k - 2]) - 0.5 * (band[x, k] + band[x, k + 1])
            strength = max(rise, 0.0) / (max(rise, 0.0) + 4.0 * noise)
            off = (k - n // 2) / allowed
            unary[x, top[x] - first + k] = 4.0 * (1.0 - strength) + off * off + passed
            if strength < before:
                passed += 2.0 * (before - strength)
            before = strength
    return unary, step


@kernel()
def _blurred_step(offset: float, blur: float) -> tuple[float, float]:
    """Mean over a pixel of a unit step (0 above the edge, 1 below) with Gaussian blur, and its change with the edge's row.

    offset: pixel centre minus edge, rows.
    """
    a = (offset + 0.5) / blur
    b = (offset - 0.5) / blur
    phi_a = 0.5 * math.erfc(-a * 0.7071067811865476)
    phi_b = 0.5 * math.erfc(-b * 0.7071067811865476)
    density_a = 0.3989422804014327 * math.exp(-0.5 * a * a)
    density_b = 0.3989422804014327 * math.exp(-0.5 * b * b)
    return blur * (a * phi_a + density_a - b * phi_b - density_b), phi_b - phi_a


@kernel()
def _fit_step(
    profile: Floats32, start: float, blur: float, reach: float
) -> tuple[float, float, float, float]:
    """Least-squares blurred step in the rows within `reach` of `start`.

    Returns:
        Edge in profile rows, contrast, residual variance, and what that is multiplied by to give the edge's variance.
    """
    low = max(0, math.ceil(start - reach))
    high = min(profile.size - 1, math.floor(start + reach))
    n = high - low + 1
    edge = start
    drop = 0.0
    variance = 0.0
    factor = 1e6
    step = np.empty(n)
    change = np.empty(n)
    for _ in range(8):
        # with the edge held, the two levels follow from linear least squares
        sf = 0.0
        sff = 0.0
        sy = 0.0
        sfy = 0.0
        sg = 0.0
        sfg = 0.0
        for k in range(n):
            f, g = _blurred_step(low + k - edge, blur)
            step[k] = f
            change[k] = g
            y = profile[low + k]
            sf += f
            sff += f * f
            sy += y
            sfy += f * y
            sg += g
            sfg += f * g
        determinant = n * sff - sf * sf
        if determinant < 1e-9:
            break
        drop = (n * sfy - sf * sy) / determinant
        sky = (sy - drop * sf) / n
        # Gauss-Newton for the edge, with the levels projected out of its derivative
        beta = (n * sfg - sf * sg) / determinant
        alpha = (sg - beta * sf) / n
        jj = 0.0
        jr = 0.0
        rr = 0.0
        for k in range(n):
            residual = profile[low + k] - sky - drop * step[k]
            j = drop * (change[k] - alpha - beta * step[k])
            jj += j * j
            jr += j * residual
            rr += residual * residual
        variance = rr / max(n - 3.0, 1.0)
        if jj < 1e-12:
            break
        factor = 1.0 / jj
        move = min(max(jr / jj, -0.5), 0.5)
        edge += move
        if abs(edge - start) > 3.0 or abs(move) < 1e-3:
            break
    return edge, -drop, variance, factor


@kernel()
def _fit_columns(
    band: Floats32, start: Floats, slope: Floats, blur: float, every: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """`_fit_step` for every `every`-th column; on a slope the edge is wider when seen along the column."""
    count = (band.shape[0] + every - 1) // every
    edge = np.empty(count)
    contrast = np.empty(count)
    variance = np.empty(count)
    factor = np.empty(count)
    for i in range(count):
        x = i * every
        steep = min(abs(slope[x]), 4.0)
        wide = math.sqrt(blur * blur * (1 + steep * steep) + steep * steep / 12)
        edge[i], contrast[i], variance[i], factor[i] = _fit_step(band[x], start[x], wide, 3.0 + 1.5 * wide)
    return edge, contrast, variance, factor


def _blur(band: Floats32, start: Floats, slope: Floats) -> float:
    """The blur that fits a sample of columns best."""
    every = max(1, start.size // _SAMPLED_COLUMNS)
    relative_residual = []
    for blur in _BLURS_PX:
        _, contrast, variance, _ = _fit_columns(band, start, slope, blur, every)
        relative_residual.append(float(np.median(np.sqrt(variance) / np.maximum(np.abs(contrast), 1.0))))
    return _BLURS_PX[int(np.argmin(relative_residual))]
