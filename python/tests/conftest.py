"""The experiment and the golden files that the library's own tests use."""

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import snakeloop

ROOT = Path(__file__).resolve().parents[2]
BENDING = ROOT / "fixtures" / "bending"


def columns(path):
    """A CSV file of numbers as a dict of arrays."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def picture(path):
    return np.asarray(Image.open(path))


@pytest.fixture(scope="session")
def frames():
    return [picture(path) for path in sorted((BENDING / "frames").glob("*.jpg"))]


@pytest.fixture(scope="session")
def lens():
    return snakeloop.Lens.read(BENDING / "camera.yaml")


@pytest.fixture(scope="session")
def rig(lens):
    straight = picture(BENDING / "straight.jpg")
    return snakeloop.Rig.calibrate(straight, lens, grid_pitch_mm=1.0, standoff_mm=25.0)


@pytest.fixture(scope="session")
def eye(lens, rig, frames):
    return snakeloop.Eye(lens, rig).refined(frames)


@pytest.fixture(scope="session")
def measured(eye, frames):
    return [eye.measure(frame) for frame in frames]
