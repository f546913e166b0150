"""Measures a snake-like surgical robot in camera frames, learns its actuation losses and compensates them."""

from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any, Protocol, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Discovery",
    "Estimator",
    "Eye",
    "Lens",
    "Measurement",
    "Model",
    "Rig",
    "SnakeloopError",
    "Step",
    "__version__",
    "discover",
    "simulate",
]

__version__: str

_Path: TypeAlias = str | PathLike[str]
_Numbers: TypeAlias = NDArray[np.float64]
_Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

class _DataFrame(Protocol):
    """A data frame, such as pandas': columns by name."""

    def __getitem__(self, name: str, /) -> Any: ...
    def __contains__(self, name: object, /) -> bool: ...

_Table: TypeAlias = _Path | Mapping[str, ArrayLike] | _DataFrame

class SnakeloopError(Exception):
    """What went wrong, where, and what to do about it."""

    path: str | None
    """The file, where there is one."""
    line: int | None
    """Its line, counted from 1, where there is one."""

@final
class Model:
    """A robot, its friction, and what was learned of its actuation lines."""

    @staticmethod
    def read(path: _Path) -> Model:
        """Reads a model.toml."""
    @staticmethod
    def default() -> Model:
        """The paper's robot (Table I) with naive compensation: η = 1, λ = 0."""
    def write(self, path: _Path) -> None:
        """Writes a model.toml, whole or not at all."""
    def command(
        self,
        theta: ArrayLike | None = None,
        delta: ArrayLike | None = None,
        *,
        theta_deg: ArrayLike | None = None,
        delta_deg: ArrayLike | None = None,
    ) -> _Numbers:
        """The q̃ to command so that the snake takes these poses, mm (Eq. 23).

        Angles in radians (theta, delta) or degrees (theta_deg, delta_deg), numbers or arrays, which are broadcast against each
        other to a shape S. Returns an array of shape S + (backbones,). NaN where an angle is NaN.
        """
    def forward(self, q_mm: ArrayLike) -> tuple[_Numbers, _Numbers]:
        """The poses that commands lead to: (theta_deg, delta_deg), arrays of the shape of q_mm less its last axis.

        q_mm has a column for each backbone, mm. NaN where the model has no answer: a q̃ that is not finite, or that bends the
        snake beyond 120°.
        """
    @property
    def eta(self) -> float:
        """η; 1 where it was not estimated."""
    @property
    def lambda_mm(self) -> float:
        """λ, mm; 0 where it was not estimated."""
    @property
    def covariance(self) -> _Numbers:
        """Covariance of (η, λ in mm), 2 × 2; zeros where they were not estimated."""
    @property
    def backbones(self) -> int:
        """How many secondary backbones the robot has."""
    @property
    def effects(self) -> list[dict[str, Any]]:
        """The model's effects: for each its name, form, and parameters with value, sd and unit."""

@final
class Lens:
    """A camera's intrinsics and distortion."""

    @staticmethod
    def read(path: _Path) -> Lens:
        """Reads a camera file: OpenCV's FileStorage (YAML or XML) or ROS camera_info YAML."""
    @property
    def width(self) -> int:
        """Width of its pictures, px."""
    @property
    def height(self) -> int:
        """Height of its pictures, px."""

@final
class Rig:
    """Where camera, grid target and base are."""

    @staticmethod
    def calibrate(
        image: _Image,
        lens: Lens,
        *,
        grid_pitch_mm: float,
        standoff_mm: float,
        robot: Model | None = None,
        delta_offset_deg: float = 0.0,
    ) -> Rig:
        """Calibrates a rig from a picture of the unbent snake before the grid target.

        image: uint8 or uint16, (height, width) grey or (height, width, 3) RGB. grid_pitch_mm: from one thin line of the grid to
        the next. standoff_mm: from the snake's axis back to the grid. robot: the Model whose robot it is; the paper's without.
        delta_offset_deg: azimuth, in the base's frame, of the direction that points to the image's right.
        """
    @staticmethod
    def read(path: _Path) -> Rig:
        """Reads a rig.toml."""
    def write(self, path: _Path) -> None:
        """Writes a rig.toml, whole or not at all."""

@final
class Measurement:
    """What one frame says."""

    def __new__(cls, *, theta_deg: float, delta_deg: float, sigma_theta_deg: float, sigma_delta_deg: float
    ) -> Measurement:
        """A measurement that comes from elsewhere, such as a tracker: angles and their standard deviations, degrees."""
    @property
    def status(self) -> str:
        """"ok", or the reason why there are no angles, in snake_case."""
    @property
    def theta_deg(self) -> float:
        """The bend from straight, degrees; NaN where it was not measured."""
    @property
    def delta_deg(self) -> float:
        """The azimuth that the tip leans towards, degrees in (−180, 180]; NaN where it was not measured."""
    @property
    def sigma_theta_deg(self) -> float:
        """Standard deviation of θ, degrees."""
    @property
    def sigma_delta_deg(self) -> float:
        """Standard deviation of δ, degrees; large near straight."""
    @property
    def covariance(self) -> _Numbers:
        """Covariance of (θ, δ), 2 × 2, square degrees."""

@final
class Eye:
    """Measures the snake in the frames of one calibrated view."""

    def __new__(cls, lens: Lens, rig: Rig, robot: Model | None = None) -> Eye:
        """An eye for one view. robot: the Model whose robot it sees; the paper's without."""
    def measure(self, image: _Image) -> Measurement:
        """Measures one frame: uint8 or uint16, (height, width) grey or (height, width, 3) RGB.

        A frame that cannot be measured gives a Measurement whose status says why. Other threads of Python run meanwhile.
        """
    def refined(self, images: Iterable[_Image]) -> Eye:
        """An eye whose rig is made better with frames of the sequence that is to be measured: some twenty, bent to all sides.

        ``snakeloop run`` does the same.
        """
    @property
    def rig(self) -> Rig:
        """The rig that it measures by."""

@final
class Step:
    """What one measurement did to the estimate."""

    @property
    def verdict(self) -> str:
        """"used", "rejected" (an outlier) or "skipped" (nothing to use)."""
    @property
    def reason(self) -> str | None:
        """Why it was not used, in snake_case; None where it was."""
    @property
    def residual_mm(self) -> _Numbers | None:
        """Measured ε less what the estimate before predicted, for each backbone, mm; None before the first estimate."""

@final
class Estimator:
    """The recursive estimator of η and λ (Eq. 19)."""

    def __new__(cls, model: Model | None = None, *, sd_encoder_mm: float | None = None) -> Estimator:
        """Starts with nothing known of η and λ.

        model: whose robot, friction and effects are used; the paper's without. sd_encoder_mm: standard deviation of an encoder
        reading, mm; 0.0015 without.
        """
    def update(self, measurement: Measurement, q_mm: ArrayLike) -> Step:
        """Takes one measurement and the encoder readings of its frame, mm, shape (backbones,)."""
    @property
    def eta(self) -> float | None:
        """η; None while the measurements do not tell."""
    @property
    def lambda_mm(self) -> float | None:
        """λ, mm; None while the measurements do not tell."""
    @property
    def covariance(self) -> _Numbers | None:
        """Covariance of (η, λ in mm), 2 × 2; None while the measurements do not tell."""
    @property
    def model(self) -> Model:
        """The model with the estimate as it stands."""

@final
class Discovery:
    """What `discover` found: verdict, effects, gap, and the model with the effects added."""

    @property
    def verdict(self) -> str:
        """"named", "partly", "none" or "unexplained"."""
    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects, as in discrepancy.json: name, parameters with value, sd and unit, evidence, removes, probability."""
    @property
    def gap(self) -> dict[str, float]:
        """The gap on data that the fit did not see, as in discrepancy.json: before_mm, after_mm, noise_floor_mm …"""
    @property
    def remarks(self) -> list[str]:
        """What was passed over or could not be decided, in sentences."""
    @property
    def model(self) -> Model:
        """The model, with the effects where they are named."""
    def as_dict(self) -> dict[str, Any]:
        """All of discrepancy.json."""
    def _repr_html_(self) -> str: ...

def discover(
    measurements: _Table, encoders: _Table, model: Model | None = None, *, sd_encoder_mm: float | None = None
) -> Discovery:
    """Compares what a model predicts with what was measured, and names what is missing.

    measurements and encoders: paths of measurements.csv and encoders.csv, data frames, or dicts of arrays with these files'
    columns. model: the Model to start from; the paper's without. sd_encoder_mm: standard deviation of an encoder reading, mm;
    0.0015 without.

    Takes seconds to minutes, during which other threads of Python run. A Ctrl-C raises KeyboardInterrupt at once; what was begun
    then goes on in the background to its end, or to that of the process.
    """

def simulate(
    model: Model | None = None,
    *,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    trajectory: Mapping[str, ArrayLike] | _DataFrame | None = None,
    seed: int = 1,
    sd_encoder_mm: float = 0.0015,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Simulates an experiment: (measurements, encoders, truth), dicts of arrays with the columns of the files of these names.

    model: what the snake obeys; the paper's without. effects: what it obeys besides, {name: {parameter: value}}. trajectory: a
    table with index, time_s, theta_deg, delta_deg; the bending experiment of the paper without. seed: the same gives the same
    noise.
    """
