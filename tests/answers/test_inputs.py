"""The fingerprint of a case's input tells another input from last bits, in which machines differ."""

from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from frozen_answers.ground import Grid, Ground
from frozen_answers.inputs import Fingerprint, Look, Question, fingerprint

from localizer import Camera, FrameObservation, Movement, Observation

CAMERA = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)
U_PX = np.arange(64.0)
FRAME = FrameObservation(
    label="N",
    camera=CAMERA,
    azimuth_deg=10.0,
    azimuth_sigma_deg=0.1,
    tilt_deg=2.0,
    tilt_sigma_deg=0.01,
    roll_deg=0.5,
    roll_sigma_deg=0.05,
    u_px=U_PX,
    v_px=20.0 + 5.0 * np.sin(U_PX / 7.0),
    sigma_px=np.full(64, 0.3),
)
OBSERVATION = Observation((FRAME,), 2.0, 512.0, 5.0, 1.0, 0.05)
GRID = Grid(500.0 + np.add.outer(np.arange(20.0), np.arange(30.0)), Affine(30.0, 0.0, 5e5, 0.0, -30.0, 4e6))


def asked(observation=OBSERVATION, grid=GRID, movement=None, **options) -> Question:
    return Question(Ground((grid,), options), (Look(observation, movement=movement),))


def with_frame(**fields) -> Observation:
    return replace(OBSERVATION, frames=(replace(FRAME, **fields),))


def is_the_same(question: Question) -> bool:
    return not fingerprint(question).differs_from(fingerprint(asked()))


def test_the_same_input_has_the_same_fingerprint():
    assert fingerprint(asked()) == fingerprint(asked())


def one_raised(values: np.ndarray, by: float) -> np.ndarray:
    raised = values.copy()
    raised.flat[7] += by
    return raised


@pytest.mark.parametrize(
    "question",
    [
        asked(with_frame(v_px=FRAME.v_px * (1.0 + 2e-15))),
        asked(with_frame(azimuth_deg=np.nextafter(10.0, 11.0))),
        asked(grid=replace(GRID, height_m=np.nextafter(GRID.height_m.astype(np.float32), np.inf))),
    ],
)
def test_last_bits_are_the_same(question):
    assert is_the_same(question)


@pytest.mark.parametrize(
    "question",
    [
        asked(with_frame(v_px=one_raised(FRAME.v_px, 0.1))),
        asked(with_frame(v_px=FRAME.v_px + 0.01)),
        asked(with_frame(v_px=FRAME.v_px[::-1])),
        asked(with_frame(u_px=U_PX[1:], v_px=FRAME.v_px[1:], sigma_px=FRAME.sigma_px[1:])),
        asked(with_frame(sigma_px=np.full(64, 0.31))),
        asked(with_frame(azimuth_deg=10.001)),
        asked(with_frame(roll_sigma_deg=0.051)),
        asked(replace(OBSERVATION, altitude_m=512.01)),
        asked(replace(OBSERVATION, altitude_m=None)),
        asked(replace(OBSERVATION, azimuth_bias_sigma_deg=180.0)),
        asked(grid=replace(GRID, height_m=one_raised(GRID.height_m, 1.0))),
        asked(grid=replace(GRID, height_m=one_raised(GRID.height_m, np.nan))),
        asked(grid=replace(GRID, crs="EPSG:32611")),
        asked(grid=replace(GRID, transform=GRID.transform @ Affine.translation(0.01, 0.0))),
        asked(grid=replace(GRID, dtype="int16")),
        asked(error_m=0.0),
        asked(movement=Movement(np.array([200.0, 0.0]), np.eye(2))),
    ],
)
def test_another_input_is_another(question):
    assert not is_the_same(question)


def test_more_numbers_are_another_input():
    assert Fingerprint("a", (1.0,)).differs_from(Fingerprint("a", (1.0, 2.0)))
