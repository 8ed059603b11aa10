"""What is compiled or loaded before the first picture is everything that a picture needs."""

import subprocess
import sys

SCRIPT = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from localizer.skyline.find import find_skyline
from localizer.search.locate import load_picture_kernels


def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("localizer.")]
    kernels = {f for module in modules for f in vars(module).values() if isinstance(f, Dispatcher)}
    return {f"{f.__module__}.{f.__name__}": len(f.overloads) for f in kernels}

load_picture_kernels()
before = compiled()
u, v = np.meshgrid(np.arange(320), np.arange(240))
hills = v > 120 + 25 * np.sin(u / 40) + 9 * np.sin(u / 11)
picture = np.where(hills[..., None], (45, 80, 60), (215, 190, 150)) + np.random.default_rng(1).normal(0, 4, (240, 320, 3))
skyline = find_skyline(np.clip(picture, 0, 255).astype(np.uint8))
assert np.isfinite(skyline.row_px).mean() > 0.9
print(sorted(name for name, count in compiled().items() if count > before[name]))
"""


def test_a_first_picture_has_nothing_compiled() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
