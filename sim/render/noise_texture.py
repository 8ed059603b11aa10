"""Procedural noise: one periodic texture, looked up at many scales."""

import numpy as np
from numpy.typing import NDArray

from sim.jit import kernel

SIZE = 256  # texels a side; a power of two, so that wrapping is a mask
WAVELENGTH = 12.0  # texels of the texture's strongest waves


def noise_texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """Isotropic noise of about one wavelength and of unit variance (SIZE, SIZE)."""
    frequency = np.fft.fftfreq(SIZE)
    along_y, along_x = np.meshgrid(frequency, frequency, indexing="ij")
    radius = np.hypot(along_x, along_y)
    radius[0, 0] = 1.0
    band = np.exp(-0.5 * (np.log(radius * WAVELENGTH) / 0.45) ** 2) / radius
    band[0, 0] = 0.0
    texture = np.fft.ifft2(np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * band).real
    return np.ascontiguousarray(texture / texture.std(), dtype=np.float32)


@kernel(inline="always", error_model="numpy", fastmath=True)
def noise_at(texture, x, y):  # type: ignore[no-untyped-def]
    """Noise at (x, y) texels: the bilinear value, and its slopes along x and y per texel."""
    floor_x, floor_y = np.floor(x), np.floor(y)
    fx, fy = np.float32(x - floor_x), np.float32(y - floor_y)
    j0, i0 = np.int64(floor_x) & (SIZE - 1), np.int64(floor_y) & (SIZE - 1)
    j1, i1 = (j0 + 1) & (SIZE - 1), (i0 + 1) & (SIZE - 1)
    v00, v01, v10, v11 = texture[i0, j0], texture[i0, j1], texture[i1, j0], texture[i1, j1]
    upper, lower = v00 + fx * (v01 - v00), v10 + fx * (v11 - v10)
    slope_x = (v01 - v00) + fy * ((v11 - v10) - (v01 - v00))
    return upper + fy * (lower - upper), slope_x, lower - upper
