//! `Lens`, `Rig`, `Eye` and `Measurement`: pictures to θ and δ.

use crate::arrays::{frame_of, matrix, numbers_of};
use crate::error::{raised, wrong};
use crate::robot::robot_in;
use crate::threads::interruptible;
use nalgebra::{Matrix2, Vector2};
use numpy::ndarray::{Array1, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use snakeloop::Error;
use snakeloop::camera::{CameraNumbers, Frame, Lens, Samples};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{self, Bend, Eye, FrameMeasurement, Rig, RigOptions, calibrate_rig};
use snakeloop::observation::{Measured, Measurement};
use snakeloop::report::overlay::{Shape, overlay_unnumbered};
use std::f64::consts::PI;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// A square radian, square degrees.
///
/// Derived: (180/π)².
const SQUARE_DEGREES: f64 = (180.0 / PI) * (180.0 / PI);

/// A camera's intrinsics and distortion.
#[pyclass(name = "Lens", module = "snakeloop", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct PyLens(Lens);

#[pymethods]
impl PyLens {
    /// A lens from its numbers, as OpenCV's calibration gives them.
    ///
    /// K: the camera matrix, 3 × 3. dist: 0, 4, 5, 8, 12 or 14 distortion coefficients in OpenCV's order; the 4 of a fisheye with fisheye=True.
    /// size: width and height of its pictures, px.
    #[new]
    #[pyo3(signature = (K, dist, size, *, fisheye=false))]
    #[allow(non_snake_case, reason = "the name that OpenCV and experiment.toml have for it")]
    fn new(K: &Bound<'_, PyAny>, dist: &Bound<'_, PyAny>, size: [u32; 2], fisheye: bool) -> PyResult<Self> {
        let matrix = numbers_of(K)?;
        if matrix.shape() != [3, 3] {
            return Err(wrong(format!("K: shape {:?}, expected [3, 3]", matrix.shape())));
        }
        let matrix = std::array::from_fn(|row| std::array::from_fn(|column| matrix[[row, column]]));
        let dist = numbers_of(dist)?.into_iter().collect();
        Lens::of_numbers(&CameraNumbers { matrix, dist, size, fisheye }).map(Self).map_err(raised)
    }

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
    /// the next. standoff_mm: from the snake's axis back to the grid. robot: a Robot, or the Model whose robot it is; the paper's without.
    /// delta_offset_deg: azimuth, in the base's frame, of the direction that points to the image's right.
    #[staticmethod]
    #[pyo3(signature = (image, lens, *, grid_pitch_mm, standoff_mm, robot=None, delta_offset_deg=0.0))]
    fn calibrate(
        py: Python<'_>,
        image: &Bound<'_, PyAny>,
        lens: &PyLens,
        grid_pitch_mm: f64,
        standoff_mm: f64,
        robot: Option<&Bound<'_, PyAny>>,
        delta_offset_deg: f64,
    ) -> PyResult<Self> {
        let (frame, lens, robot) = (frame_of(image, Vec::new())?, lens.0.clone(), robot_in(robot)?);
        let options = RigOptions { grid_pitch_mm, standoff_mm, delta_offset: delta_offset_deg.to_radians() };
        let rig = interruptible(py, move || calibrate_rig(&frame, &lens, &robot, &options))?;
        rig.map(Self).map_err(|why| raised(Error::from(why)))
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

    /// What is seen of a picture, while other threads of Python run.
    fn seen(
        &self,
        image: &Bound<'_, PyAny>,
        see: impl FnOnce(&Frame) -> FrameMeasurement + Send,
    ) -> PyResult<PyMeasurement> {
        let spare = || self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let frame = frame_of(image, std::mem::take(&mut *spare()))?;
        let measurement = image.py().detach(|| see(&frame));
        if let Samples::Bits8(samples) = frame.samples {
            *spare() = samples;
        }
        image.py().check_signals()?;
        Ok(PyMeasurement(measurement))
    }
}

#[pymethods]
impl PyEye {
    /// An eye for one view. robot: a Robot, or the Model whose robot it sees; the paper's without.
    #[new]
    #[pyo3(signature = (lens, rig, robot=None))]
    fn new(py: Python<'_>, lens: &PyLens, rig: &PyRig, robot: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let robot = robot_in(robot)?;
        Ok(py.detach(|| Self::of(Eye::new(lens.0.clone(), rig.0.clone(), robot))))
    }

    /// Measures one frame: uint8 or uint16, (height, width) grey or (height, width, 3) RGB.
    ///
    /// A frame that cannot be measured gives a Measurement whose status says why. Other threads of Python run meanwhile.
    fn measure(&self, image: &Bound<'_, PyAny>) -> PyResult<PyMeasurement> {
        self.seen(image, |frame| self.eye.measure(frame))
    }

    /// Measures one frame of a sequence, in which the snake is near to where it was in the frame before: says the same as measure to about
    /// a hundredth of a degree, sooner.
    ///
    /// near: the Measurement of the frame before, or (theta_deg, delta_deg). The snake is looked for everywhere where it is not found near
    /// that, or where the frame before has no angles.
    fn track(&self, image: &Bound<'_, PyAny>, near: &Bound<'_, PyAny>) -> PyResult<PyMeasurement> {
        let last = if let Ok(measurement) = near.cast::<PyMeasurement>() {
            measurement.get().0.bend.map(|bend| bend.vector)
        } else if let Ok((theta_deg, delta_deg)) = near.extract::<(f64, f64)>() {
            Some(Configuration::from_degrees(theta_deg, delta_deg).bend_vector())
        } else {
            let found = near.get_type();
            return Err(wrong(format!("near: {found}, expected a Measurement or (theta_deg, delta_deg)")));
        };
        self.seen(image, |frame| match last {
            Some(last) => self.eye.track(frame, last),
            None => self.eye.measure(frame),
        })
    }

    /// The frame with what was measured drawn on it, as the command run draws it: uint8, (height, width, 3) RGB.
    ///
    /// measurement: that of this frame, or of several views of this moment (fused).
    fn overlay<'py>(
        &self,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
        measurement: &PyMeasurement,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let frame = frame_of(image, Vec::new())?;
        let measurement = measurement.row();
        let picture = py.detach(|| {
            let shape = measurement.profile().map(|profile| Shape::of(&self.eye.projection(), profile));
            overlay_unnumbered(&frame, &measurement, shape.as_ref())
        });
        let shape = (picture.height() as usize, picture.width() as usize, 3);
        let picture = Array3::from_shape_vec(shape, picture.into_raw()).map_err(|e| wrong(e.to_string()))?;
        Ok(picture.into_pyarray(py))
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
#[pyclass(name = "Measurement", module = "snakeloop", frozen, from_py_object)]
#[derive(Clone)]
pub struct PyMeasurement(pub FrameMeasurement);

impl PyMeasurement {
    fn measured(&self) -> Option<&Measured> {
        self.0.measured.as_ref()
    }

    /// Its row of measurements.csv, as the first.
    fn row(&self) -> Measurement {
        self.0.clone().row(0, None, None)
    }
}

/// What several views of one moment say together: one Measurement, weighted by how sure each view is.
///
/// A view without angles is left out; where none has any, the first one's reason stands. Views that contradict each other give the status
/// "views_disagree" and no angles.
#[pyfunction]
pub fn fused(measurements: Vec<PyMeasurement>) -> PyResult<PyMeasurement> {
    if measurements.is_empty() {
        return Err(wrong("measurements: none were given, expected one of each view"));
    }
    let measurements: Vec<FrameMeasurement> = measurements.into_iter().map(|measurement| measurement.0).collect();
    Ok(PyMeasurement(measure::fused(&measurements)))
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
        Ok(Self(Measured::independent(configuration, sigma_theta, sigma_delta, 0.0).into()))
    }

    /// "ok", or the reason why there are no angles, in snake_case.
    #[getter]
    fn status(&self) -> String {
        self.0.status.to_string()
    }

    /// The bend from straight, degrees; NaN where it was not measured.
    #[getter]
    fn theta_deg(&self) -> f64 {
        self.measured().map_or(f64::NAN, |measured| measured.configuration.theta_deg())
    }

    /// The azimuth that the tip leans towards, degrees in (−180, 180]; NaN where it was not measured.
    #[getter]
    fn delta_deg(&self) -> f64 {
        self.measured().map_or(f64::NAN, |measured| measured.configuration.delta_deg())
    }

    /// Standard deviation of θ, degrees.
    #[getter]
    fn sigma_theta_deg(&self) -> f64 {
        self.measured().map_or(f64::NAN, |measured| measured.sigma_theta.to_degrees())
    }

    /// Standard deviation of δ, degrees; large near straight.
    #[getter]
    fn sigma_delta_deg(&self) -> f64 {
        self.measured().map_or(f64::NAN, |measured| measured.sigma_delta.to_degrees())
    }

    /// Covariance of (θ, δ), 2 × 2, square degrees.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let covariance = self.measured().map_or(Matrix2::repeat(f64::NAN), |measured| measured.covariance());
        matrix(py, &(covariance * SQUARE_DEGREES))
    }

    /// The bend vector θ (cos δ, sin δ), degrees, which has a meaning near straight as well.
    #[getter]
    fn bend_deg<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let bend = self.0.bend.map_or(Vector2::repeat(f64::NAN), |Bend { vector, .. }| vector.map(f64::to_degrees));
        Array1::from_iter(bend.iter().copied()).into_pyarray(py)
    }

    /// Its covariance, 2 × 2, square degrees.
    #[getter]
    fn bend_covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let covariance = self.0.bend.map_or(Matrix2::repeat(f64::NAN), |Bend { covariance, .. }| covariance);
        matrix(py, &(covariance * SQUARE_DEGREES))
    }

    fn __repr__(&self) -> String {
        match self.measured() {
            Some(_) => format!(
                "<Measurement θ = {:.3} ± {:.3}°, δ = {:.3} ± {:.3}°>",
                self.theta_deg(),
                self.sigma_theta_deg(),
                self.delta_deg(),
                self.sigma_delta_deg()
            ),
            None => format!("<Measurement {}>", self.0.status),
        }
    }
}
