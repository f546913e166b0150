"""Measures a snake-like surgical robot in camera frames, learns its actuation losses and compensates them."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Discovery",
    "Estimate",
    "Estimator",
    "Eye",
    "Lens",
    "Measurement",
    "Model",
    "Rig",
    "Robot",
    "Run",
    "SnakeloopError",
    "StemEstimate",
    "Step",
    "TipForce",
    "Verdict",
    "__version__",
    "discover",
    "estimate",
    "estimate_stem",
    "fused",
    "run",
    "simulate",
    "tip_force",
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
class Robot:
    """The constants of one robot."""

    def __new__(
        cls,
        *,
        length_mm: float = 26.0,
        backbone_circle_radius_mm: float = 1.5,
        backbones: int = 3,
        primary: Mapping[str, float] = ...,
        secondary: Mapping[str, float] = ...,
        line: Mapping[str, float] = ...,
        body: Mapping[str, Any] = ...,
    ) -> Robot:
        """A robot by its constants, under the keys of [robot] in a model.toml; its tables are dicts. What is left out is the paper's.

        primary, secondary (the tubes): outer_diameter_mm, inner_diameter_mm, youngs_modulus_gpa. line: holder_length_mm,
        cone_bend_radius_mm, cone_bend_angle_deg, cone_straight_mm. body: disk_diameter_mm, disk_thickness_mm, spacer_disk_count,
        disk_positions_mm, tool (length_mm, diameter_mm).
        """
    @property
    def constants(self) -> dict[str, Any]:
        """All constants, as a dict of the form in which Robot takes them."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class Verdict:
    """Whether a result can be relied on, and why not. It is neither true nor false: compare its level."""

    @property
    def level(self) -> Literal["good", "look", "do_not_use"]:
        """The worst of the reasons' levels."""
    @property
    def reasons(self) -> list[dict[str, Any]]:
        """The reasons, the worst first: code, level, text, remedy, and suggestion where the mistake can be written down."""
    def __eq__(self, other: object, /) -> bool: ...
    def __bool__(self) -> bool: ...
    def _repr_html_(self) -> str: ...

@final
class Model:
    """A robot, its friction, and what was learned of its actuation lines."""

    def __new__(cls, robot: Robot | Model | None = None) -> Model:
        """A robot with naive compensation: η = 1, λ = 0. robot: the paper's without."""
    @staticmethod
    def read(path: _Path) -> Model:
        """Reads a model.toml. Warns of one that must not be used, or is marked as stale."""
    @staticmethod
    def default() -> Model:
        """The paper's robot (Table I) with naive compensation: η = 1, λ = 0."""
    def write(self, path: _Path) -> None:
        """Writes a model.toml, whole or not at all; with the verdict on it, where there is one."""
    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> Model:
        """This model with further effects, as --effect adds them: {name: {parameter: value}}.

        A load on the tip: model.with_effects({"tip_load": {"fx_n": 0.2, "fy_n": 0.0, "fz_n": -0.1}}).
        """
    def table(self, theta_deg: ArrayLike | None = None, delta_deg: ArrayLike | None = None) -> dict[str, NDArray[Any]]:
        """What to command for every pose of a grid: a dict of arrays with the columns of compensation.csv, one row a pose.

        theta_deg and delta_deg: the grid's axes, numbers or arrays of one dimension; without, those of the command `table`. δ runs
        fastest. sd_qc1_mm … are standard deviations; extrapolated is 1 beyond the bends that the model was learned on. A model that
        must not be used has a column do_not_use.
        """
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
    def robot(self) -> Robot:
        """The constants of its robot."""
    @property
    def backbones(self) -> int:
        """How many secondary backbones the robot has."""
    @property
    def effects(self) -> list[dict[str, Any]]:
        """The model's effects: for each its name, form, and parameters with value, sd and unit."""

@final
class Lens:
    """A camera's intrinsics and distortion."""

    def __new__(cls, K: ArrayLike, dist: ArrayLike, size: Sequence[int], *, fisheye: bool = False) -> Lens:
        """A lens from its numbers, as OpenCV's calibration gives them.

        K: the camera matrix, 3 × 3. dist: 0, 4, 5, 8, 12 or 14 distortion coefficients in OpenCV's order; the 4 of a fisheye with
        fisheye=True. size: width and height of its pictures, px.
        """
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
        robot: Robot | Model | None = None,
        delta_offset_deg: float = 0.0,
    ) -> Rig:
        """Calibrates a rig from a picture of the unbent snake before the grid target.

        image: uint8 or uint16, (height, width) grey or (height, width, 3) RGB. grid_pitch_mm: from one thin line of the grid to
        the next. standoff_mm: from the snake's axis back to the grid. robot: the paper's without.
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
    @property
    def bend_deg(self) -> _Numbers:
        """The bend vector θ (cos δ, sin δ), degrees, which has a meaning near straight as well; NaN where it was not measured."""
    @property
    def bend_covariance(self) -> _Numbers:
        """Its covariance, 2 × 2, square degrees."""

def fused(measurements: Sequence[Measurement]) -> Measurement:
    """What several views of one moment say together: one Measurement, weighted by how sure each view is.

    A view without angles is left out; where none has any, the first one's reason stands. Views that contradict each other give the
    status "views_disagree" and no angles.
    """

@final
class Eye:
    """Measures the snake in the frames of one calibrated view."""

    def __new__(cls, lens: Lens, rig: Rig, robot: Robot | Model | None = None) -> Eye:
        """An eye for one view. robot: the paper's without."""
    def measure(self, image: _Image) -> Measurement:
        """Measures one frame: uint8 or uint16, (height, width) grey or (height, width, 3) RGB.

        A frame that cannot be measured gives a Measurement whose status says why. Other threads of Python run meanwhile.
        """
    def track(self, image: _Image, near: Measurement | tuple[float, float]) -> Measurement:
        """Measures one frame of a sequence, in which the snake is near to where it was in the frame before.

        Says the same as measure to about a hundredth of a degree, sooner. near: the Measurement of the frame before, or
        (theta_deg, delta_deg). The snake is looked for everywhere where it is not found near that, or where the frame before has no
        angles.
        """
    def overlay(self, image: _Image, measurement: Measurement) -> NDArray[np.uint8]:
        """The frame with what was measured drawn on it, as `snakeloop run` draws it: (height, width, 3) RGB.

        measurement: that of this frame, or of several views of this moment (fused).
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
class Estimate:
    """What `estimate` learned."""

    @property
    def verdict(self) -> Verdict:
        """Whether the estimate can be relied on, and why not."""
    @property
    def eta(self) -> float | None:
        """η; None where the measurements do not tell."""
    @property
    def lambda_mm(self) -> float | None:
        """λ, mm; None where the measurements do not tell."""
    @property
    def covariance(self) -> _Numbers | None:
        """Covariance of (η, λ in mm), 2 × 2; None where the measurements do not tell."""
    @property
    def model(self) -> Model:
        """The model with the estimate."""
    @property
    def rows(self) -> dict[str, NDArray[Any]]:
        """What became of each measurement: a dict of arrays with the columns of estimate.csv."""

def estimate(
    measurements: _Table, encoders: _Table, model: Model | None = None, *, sd_encoder_mm: float | None = None
) -> Estimate:
    """Learns η and λ from measurements and encoder readings, and judges them, as the command `estimate`.

    measurements and encoders: paths of measurements.csv and encoders.csv, data frames, or dicts of arrays with these files'
    columns. model: the Model that gives robot, friction and effects; the paper's without. sd_encoder_mm: standard deviation of an
    encoder reading, mm; 0.0015 without.
    """

@final
class StemEstimate:
    """The bending angle of a flexible stem, as it was followed."""

    @property
    def verdict(self) -> Verdict:
        """Whether the angle can be relied on, and why not."""
    @property
    def phi_deg(self) -> float:
        """Φ after the last measurement, degrees."""
    @property
    def sd_phi_deg(self) -> float:
        """Its standard deviation, degrees."""
    @property
    def model(self) -> Model:
        """The model with the stem bent by the last Φ."""
    @property
    def rows(self) -> dict[str, NDArray[Any]]:
        """Φ after each measurement: a dict of arrays with the columns of stem.csv."""

def estimate_stem(
    measurements: _Table,
    encoders: _Table,
    model: Model,
    *,
    forgetting: float | None = None,
    sd_encoder_mm: float | None = None,
) -> StemEstimate:
    """Follows the total bending angle Φ of a flexible stem, as the command `estimate --stem`.

    measurements and encoders: as in estimate. model: the Model with η, λ and friction known. forgetting: share of the information
    that is kept from one measurement to the next, 0.95 without. sd_encoder_mm: standard deviation of an encoder reading, mm; 0.0015
    without.
    """

@final
class TipForce:
    """A force on the tip that explains measured deflections."""

    @property
    def verdict(self) -> Verdict:
        """Whether the model explains the measurements under this force, and why not."""
    @property
    def force_n(self) -> _Numbers:
        """The force that explains all measurements together, N, shape (3,), in the base frame.

        It has no part along the unseen directions.
        """
    @property
    def covariance_n2(self) -> _Numbers:
        """Its covariance within the directions that are seen, N², 3 × 3."""
    @property
    def unseen(self) -> _Numbers:
        """Unit vectors along which no measurement shows a force, shape (count, 3)."""
    @property
    def rows(self) -> dict[str, NDArray[Any]]:
        """The force that explains each measurement: a dict of arrays with the columns of force.csv."""

def tip_force(
    measurements: _Table, encoders: _Table, model: Model, *, sd_encoder_mm: float | None = None
) -> TipForce:
    """Finds the force on the tip that explains measured deflections, as the command `force`.

    measurements and encoders: of the loaded snake, as in estimate. model: the Model with η and λ of the unloaded snake.
    sd_encoder_mm: standard deviation of an encoder reading, mm; 0.0015 without.
    """

@final
class Run:
    """What `run` gave."""

    @property
    def verdict(self) -> Verdict:
        """Whether the result can be relied on, and why not."""
    @property
    def eta(self) -> float | None:
        """η; None where the measurements do not tell."""
    @property
    def lambda_mm(self) -> float | None:
        """λ, mm; None where the measurements do not tell."""
    @property
    def measurements(self) -> dict[str, NDArray[Any]]:
        """The measurements of all frames: a dict of arrays with the columns of measurements.csv."""
    @property
    def model(self) -> Model:
        """The model that was learned; the experiment's own where the measurements do not tell."""
    @property
    def out(self) -> Path:
        """The folder with the files that the command writes; a temporary one goes with the Run."""
    def _repr_html_(self) -> str: ...

def run(experiment: _Path, out: _Path | None = None) -> Run:
    """Does the main job on an experiment, as the command `run`: measures every frame, learns η and λ, writes the table and a report.

    experiment: a folder with an experiment.toml, or that file. out: the folder to write to; without, a temporary one that lives as
    long as the Run. Warnings of the command are warnings of Python.

    Takes seconds to hours, during which other threads of Python run. A Ctrl-C raises KeyboardInterrupt at once; the work then ends
    at the next frame.
    """

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
