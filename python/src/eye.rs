//! `Lens`, `Rig`, `Eye` and `Measurement`: pictures to θ and δ.

use crate::arrays::{frame_of, matrix};
use crate::error::{raised, wrong};
use crate::model::PyModel;
use crate::threads::interruptible;
use nalgebra::Matrix2;
use numpy::PyArray2;
use pyo3::prelude::*;
use snakeloop::camera::{Frame, Lens, Samples};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, FrameMeasurement, Rig, RigOptions, calibrate_rig};
use snakeloop::observation::{Measured, Status};
use snakeloop::robot::Robot;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A camera's intrinsics and distortion.
#[pyclass(name = "Lens", module = "snakeloop", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct PyLens(Lens);

#[pymethods]
impl PyLens {
    /// Reads a camera file: OpenCV's FileStorage (YAML or XML) or ROS camera_info YAML.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        Lens::read(&path).map(Self).map_err(raised)
    }

    /// Width of its pictures, px.
    #[getter]
    fn width(&self) -> u32 {
        self.0.width
    }

    /// Height of its pictures, px.
    #[getter]
    fn height(&self) -> u32 {
        self.0.height
    }

    fn __repr__(&self) -> String {
        let Lens { width, height, focal_px, .. } = &self.0;
        format!("<Lens {width}×{height} px, focal lengths {:.1} and {:.1} px>", focal_px.x, focal_px.y)
    }
}

/// Where camera, grid target and base are.
#[pyclass(name = "Rig", module = "snakeloop", frozen)]
#[derive(Clone)]
pub struct PyRig(Rig);

#[pymethods]
impl PyRig {
    /// Calibrates a rig from a picture of the unbent snake before the grid target.
    ///
    /// image: uint8 or uint16, (height, width) grey or (height, width, 3) RGB. grid_pitch_mm: from one thin line of the grid to
    /// the next. standoff_mm: from the snake's axis back to the grid. robot: the Model whose robot it is; the paper's without.
    /// delta_offset_deg: azimuth, in the base's frame, of the direction that points to the image's right.
    #[staticmethod]
    #[pyo3(signature = (image, lens, *, grid_pitch_mm, standoff_mm, robot=None, delta_offset_deg=0.0))]
    fn calibrate(
        py: Python<'_>,
        image: &Bound<'_, PyAny>,
        lens: &PyLens,
        grid_pitch_mm: f64,
        standoff_mm: f64,
        robot: Option<&PyModel>,
        delta_offset_deg: f64,
    ) -> PyResult<Self> {
        let (frame, lens, robot) = (frame_of(image, Vec::new())?, lens.0.clone(), robot_of(robot));
        let options = RigOptions { grid_pitch_mm, standoff_mm, delta_offset: delta_offset_deg.to_radians() };
        let rig = interruptible(py, move || calibrate_rig(&frame, &lens, &robot, &options))?;
        rig.map(Self).map_err(|why| wrong(format!("rig calibration: {why}")))
    }

    /// Reads a rig.toml.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        Rig::read(&path).map(Self).map_err(raised)
    }

    /// Writes a rig.toml, whole or not at all.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        self.0.write(&path).map_err(raised)
    }
}

/// Measures the snake in the frames of one calibrated view.
#[pyclass(name = "Eye", module = "snakeloop", frozen)]
pub struct PyEye {
    eye: Eye,
    /// The memory of the last frame, for the next one.
    spare: Mutex<Vec<u8>>,
}

impl PyEye {
    fn of(eye: Eye) -> Self {
        Self { eye, spare: Mutex::default() }
    }
}

#[pymethods]
impl PyEye {
    /// An eye for one view. robot: the Model whose robot it sees; the paper's without.
    #[new]
    #[pyo3(signature = (lens, rig, robot=None))]
    fn new(py: Python<'_>, lens: &PyLens, rig: &PyRig, robot: Option<&PyModel>) -> Self {
        let robot = robot_of(robot);
        py.detach(|| Self::of(Eye::new(lens.0.clone(), rig.0.clone(), robot)))
    }

    /// Measures one frame: uint8 or uint16, (height, width) grey or (height, width, 3) RGB.
    ///
    /// A frame that cannot be measured gives a Measurement whose status says why. Other threads of Python run meanwhile.
    fn measure(&self, py: Python<'_>, image: &Bound<'_, PyAny>) -> PyResult<PyMeasurement> {
        let spare = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let frame = frame_of(image, std::mem::take(&mut *spare()))?;
        let FrameMeasurement { status, measured, .. } = py.detach(|| self.eye.measure(&frame));
        if let Samples::Bits8(samples) = frame.samples {
            *spare() = samples;
        }
        py.check_signals()?;
        Ok(PyMeasurement { status, measured })
    }

    /// An eye whose rig is made better with frames of the sequence that is to be measured: some twenty, bent to all sides.
    /// `snakeloop run` does the same.
    fn refined(&self, py: Python<'_>, images: &Bound<'_, PyAny>) -> PyResult<Self> {
        let frames = images.try_iter()?.map(|image| frame_of(&image?, Vec::new())).collect::<PyResult<Vec<Frame>>>()?;
        let eye = self.eye.clone();
        interruptible(py, move || Self::of(eye.refined(rayon::prelude::IntoParallelIterator::into_par_iter(frames))))
    }

    /// The rig that it measures by.
    #[getter]
    fn rig(&self) -> PyRig {
        PyRig(self.eye.rig().clone())
    }
}

/// What one frame says.
#[pyclass(name = "Measurement", module = "snakeloop", frozen)]
#[derive(Clone)]
pub struct PyMeasurement {
    pub status: Status,
    pub measured: Option<Measured>,
}

#[pymethods]
impl PyMeasurement {
    /// A measurement that comes from elsewhere, such as a tracker: angles and their standard deviations, degrees.
    #[new]
    #[pyo3(signature = (*, theta_deg, delta_deg, sigma_theta_deg, sigma_delta_deg))]
    fn new(theta_deg: f64, delta_deg: f64, sigma_theta_deg: f64, sigma_delta_deg: f64) -> PyResult<Self> {
        let sigmas = [("sigma_theta_deg", sigma_theta_deg), ("sigma_delta_deg", sigma_delta_deg)];
        if let Some((name, sigma)) = sigmas.into_iter().find(|(_, sigma)| sigma.is_nan() || *sigma <= 0.0) {
            return Err(wrong(format!("{name} is {sigma}, expected more than 0")));
        }
        for (name, angle) in [("theta_deg", theta_deg), ("delta_deg", delta_deg)] {
            if !angle.is_finite() {
                return Err(wrong(format!("{name} is {angle}, expected a number; leave out what was not measured")));
            }
        }
        let configuration = Configuration::from_degrees(theta_deg, delta_deg);
        let (sigma_theta, sigma_delta) = (sigma_theta_deg.to_radians(), sigma_delta_deg.to_radians());
        let measured = Measured::independent(configuration, sigma_theta, sigma_delta, 0.0);
        Ok(Self { status: Status::Ok, measured: Some(measured) })
    }

    /// "ok", or the reason why there are no angles, in snake_case.
    #[getter]
    fn status(&self) -> String {
        self.status.to_string()
    }

    /// The bend from straight, degrees; NaN where it was not measured.
    #[getter]
    fn theta_deg(&self) -> f64 {
        self.measured.map_or(f64::NAN, |measured| measured.configuration.theta_deg())
    }

    /// The azimuth that the tip leans towards, degrees in (−180, 180]; NaN where it was not measured.
    #[getter]
    fn delta_deg(&self) -> f64 {
        self.measured.map_or(f64::NAN, |measured| measured.configuration.delta_deg())
    }

    /// Standard deviation of θ, degrees.
    #[getter]
    fn sigma_theta_deg(&self) -> f64 {
        self.measured.map_or(f64::NAN, |measured| measured.sigma_theta.to_degrees())
    }

    /// Standard deviation of δ, degrees; large near straight.
    #[getter]
    fn sigma_delta_deg(&self) -> f64 {
        self.measured.map_or(f64::NAN, |measured| measured.sigma_delta.to_degrees())
    }

    /// Covariance of (θ, δ), 2 × 2, square degrees.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let square_degrees = 1f64.to_degrees().powi(2);
        let covariance = self.measured.map_or(Matrix2::repeat(f64::NAN), |measured| measured.covariance());
        matrix(py, &(covariance * square_degrees))
    }

    fn __repr__(&self) -> String {
        match &self.measured {
            Some(_) => format!(
                "<Measurement θ = {:.3} ± {:.3}°, δ = {:.3} ± {:.3}°>",
                self.theta_deg(),
                self.sigma_theta_deg(),
                self.delta_deg(),
                self.sigma_delta_deg()
            ),
            None => format!("<Measurement {}>", self.status),
        }
    }
}

/// The robot of a model; the paper's without.
fn robot_of(model: Option<&PyModel>) -> Robot {
    model.map(|model| model.0.robot.clone()).unwrap_or_default()
}
