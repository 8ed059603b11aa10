"""Every reader of external bytes, with arbitrary bytes: a value or its documented error, nothing else."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fakes.fuzz_targets import TARGETS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

SEEDS = [
    b"[" * 4096,
    b"{" * 4096,
    b'{"do": "trigger"}',
    b'{"do": ["status"]}',
    b"$HCHDG,238.5,,,12.1,E*17\r\n",
    b"$WIXDR,P,1.0,B,X*00",
    b"\xff\xff\xfd\x00\x01\x04\x00\x55\x00\xa1\x0c",
    b"\xff\xff\xfd\x00\x01\xff\xff\x55",
    b"PK\x05\x06" + bytes(18),
    b"PK\x03\x04",
    b"\x1f\x8b\x08\x00",
    b"a = " + b"[" * 3000,
    b".".join([b"a"] * 3000) + b"=1",
    b'{"schema": "skyfix.bundle/1"}',
    b"\x00" * 1024,
]
WORDS = st.sampled_from(
    [
        *(
            b"[",
            b"]",
            b"{",
            b"}",
            b'"',
            b":",
            b",",
            b"=",
            b"\n",
            b"\r",
            b"\\u",
            b"\xff",
            b"\xff\xff\xfd\x00",
            b"$",
        ),
        *(b"*", b"1e999", b"NaN", b"9" * 500, b"\x00", b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"),
        *(b"\x1f\x8b\x08\x00", b"ustar", b"HCHDG", b"P,", b'"do"', b'"id"'),
    ]
)


@pytest.mark.parametrize("target", TARGETS)
@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.lists(st.binary(max_size=20) | WORDS, max_size=12).map(b"".join))
def test_any_bytes_come_to_a_value_or_to_the_error_that_is_named(target: str, data: bytes) -> None:
    TARGETS[target](data)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("seed", SEEDS)
def test_bytes_that_ended_a_program_somewhere(target: str, seed: bytes) -> None:
    TARGETS[target](seed)


@pytest.mark.long
@pytest.mark.parametrize("target", TARGETS)
def test_what_a_fuzzer_finds_that_sees_the_branches(target: str, tmp_path: Path) -> None:
    """Needs atheris: ``pip install -e .[fuzz]``."""
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("atheris is not installed: pip install -e .[fuzz]")
    for number, seed in enumerate(SEEDS):
        (tmp_path / f"seed-{number}").write_bytes(seed)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "fakes.fuzz_targets",
            target,
            str(tmp_path),
            "-max_total_time=20",
            "-max_len=8192",
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
        check=False,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Done" in done.stderr
