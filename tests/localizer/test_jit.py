"""Compiled kernels that a power failure has spoilt."""

import os
import subprocess
import sys
from pathlib import Path

MODULE = """
from localizer.jit import kernel, recompiled_if_damaged

@kernel()
def doubled(x):
    return 2 * x

print(recompiled_if_damaged(lambda: doubled(21)))
"""


def test_kernels_whose_files_are_cut_off_are_compiled_anew(tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text(MODULE)
    cache = tmp_path / "cache"

    def run() -> "subprocess.CompletedProcess[str]":
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        return subprocess.run(
            [sys.executable, "module.py"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )

    assert run().stderr == ""
    for suffix, size in (("nbi", 0), ("nbc", 40)):
        (file,) = cache.rglob(f"*.{suffix}")
        os.truncate(file, size)
        mended = run()
        assert mended.stdout == "42\n"
        assert mended.stderr.startswith("compiled kernels are damaged (")
    assert run().stderr == ""
